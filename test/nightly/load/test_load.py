# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Twenty clients at once; processors that are taken."""

import os
import subprocess
import sys

import numpy as np
from pendulum_rig import COMMAND_TIMEOUT, note, PendulumRig
import pytest
from ros_harness import Ros
from tdm_planner.nodes.reading import seconds_of
from tools.soak import soak

GROWTH = 5.0  # MB in half a minute, while the planner answers thousands of requests


def test_every_call_of_many_clients_is_answered(ros, tmp_path):
    found = soak(60.0, 20, tmp_path)
    assert '' not in found['answers'], 'a call had no answer'
    assert 'INTERNAL' not in found['answers']
    assert found['answers']['PLAN'] > 0
    assert found['answers']['BUSY'] > 0
    for name, (half_way, last) in found['memory [MB]'].items():
        assert last - half_way < GROWTH, name


ON_THE_WAY = 0.1  # s that messages may take on a busy machine


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return PendulumRig(ros, 'busy', planner={'replan.rate': 5.0})


@pytest.mark.parametrize('repetition', range(5))
def test_busy_processes_take_the_processors(rig, repetition):
    """Two for every core: in real time, the motion follows the clock all the same."""
    rig.held_since(rig.plan()[0])
    count = 2 * (os.cpu_count() or 1)
    hogs = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(count)]
    try:
        began, sent = rig.now, len(rig.commands)
        rig.fall()
        held = rig.held_since(began + 0.1)
        gaps = np.diff([seconds_of(c.header.stamp) for c in rig.commands[sent:]])
        p99 = float(np.percentile(gaps, 99))
        note('processors taken', recovered=held - began, commands_p99=p99, longest=gaps.max())
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
    assert rig.longest_torque() < COMMAND_TIMEOUT + ON_THE_WAY

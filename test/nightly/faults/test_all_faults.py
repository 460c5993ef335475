# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Nodes that are ended, killed and restarted, over real DDS, over and over; all of data_faults.py.

The figures are those of docs/reliability.md; with TDM_FAULT_FIGURES=FILE they are kept there.
"""

from pathlib import Path
import time

from data_faults import FAULTS, misled_rig
from pendulum_rig import COMMAND_TIMEOUT, held_rig, note, SCENARIOS, STATE_TIMEOUT
import pytest
from rosbags.highlevel import AnyReader
from signal_scenes import SCENES, WAYS

ON_THE_WAY = 0.1  # s that messages may take on a busy machine
again = pytest.mark.parametrize('repetition', range(5))


@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize('scene', SCENES)
def test_signals_end_a_process_in_every_phase(ros, scene, way):
    for k in range(40 if scene.startswith('starting') else 1):
        subject = SCENES[scene](ros)
        time.sleep(0.05 * k)  # to meet it at another line
        codes = (128 + WAYS[way][0][0],) if 'demo' in scene else (0,)
        if scene == 'starting tdm':  # which records, or does not yet
            codes = 0, 128 + WAYS[way][0][0]
        subject.end(way, codes)
    if scene == 'busy recorder':  # what it has recorded can be read
        with AnyReader([Path(str(subject.arguments[-1]))]) as reader:
            assert reader.message_count > 10


held = pytest.fixture(held_rig, scope='module', name='held')


@again
@pytest.mark.parametrize('scenario', SCENARIOS)
def test_a_node_is_killed_and_restarted(held, scenario, repetition):
    """Whatever happens, no command acts for longer than `command_timeout`."""
    held.held_since(held.now)
    figures = SCENARIOS[scenario](held)
    note(scenario, **figures)
    assert figures['safe'] < STATE_TIMEOUT + ON_THE_WAY
    assert held.longest_torque() < COMMAND_TIMEOUT + ON_THE_WAY


@pytest.mark.parametrize('fault', FAULTS)
def test_a_mission_under_a_fault_of_data(stepped, fault):
    note(fault, **FAULTS[fault](misled_rig(stepped, fault)))

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Processes that are killed, and such that are asked to end: each kind once."""

from pendulum_rig import held_rig, SCENARIOS
import pytest
from signal_scenes import SCENES


def test_nodes_are_killed_and_the_pendulum_comes_back(ros):
    rig = held_rig(ros)
    for name in ('plant killed while holding', 'tracker killed in mid-swing',
                 'planner killed while planning'):  # fmt: skip
        rig.held_since(rig.now)
        SCENARIOS[name](rig)


@pytest.mark.parametrize(
    ('scene', 'way'),
    [
        ('starting planner', 'SIGINT'),
        ('starting tracker', 'double Ctrl-C at once'),
        ('solving planner', 'double Ctrl-C'),
        ('following tracker', 'SIGTERM'),
    ],
)
def test_a_node_is_ended_by_signals(ros, scene, way):
    """The demo and a recording beside it are ended in test_demo.py; all others by night."""
    SCENES[scene](ros).end(way)

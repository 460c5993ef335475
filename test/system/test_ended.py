# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Processes that are killed, and such that are asked to end: each kind once."""

from __future__ import annotations

from killing import held_rig, SCENARIOS
import pytest
from ros_harness import Ros
from signal_scenes import SCENES


def test_nodes_are_killed_and_the_pendulum_comes_back(ros: Ros) -> None:
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
def test_a_node_is_ended_by_signals(ros: Ros, scene: str, way: str) -> None:
    """The demo and a recording beside it are ended in test_demo.py; all others by night."""
    SCENES[scene](ros).end(way)

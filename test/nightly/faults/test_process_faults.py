# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Nodes that are killed, restarted, started twice or starved, over real DDS, over and over.

The figures are those of docs/reliability.md; `python -m tools.measure_faults` collects them.
"""

from __future__ import annotations

from collections.abc import Iterator
import copy
import os
import subprocess
import sys

from killing import held_rig, SCENARIOS
import numpy as np
from pendulum_rig import COMMAND_TIMEOUT, note, PendulumRig, STATE_TIMEOUT
import pytest
from ros_harness import Ros
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, seconds_of, to_stamp
from trajectory_msgs.msg import JointTrajectory

ON_THE_WAY = 0.1  # s that messages may take on a busy machine
again = pytest.mark.parametrize('repetition', range(5))


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return held_rig(ros)


@pytest.fixture(autouse=True)
def never_stale(rig: PendulumRig) -> Iterator[None]:
    """Whatever happens, no command acts for longer than `command_timeout`."""
    rig.held_since(rig.now)
    yield
    assert rig.longest_torque() < COMMAND_TIMEOUT + ON_THE_WAY


@again
@pytest.mark.parametrize('scenario', SCENARIOS)
def test_a_node_is_killed_and_restarted(rig: PendulumRig, scenario: str, repetition: int) -> None:
    figures = SCENARIOS[scenario](rig)
    note(scenario, **figures)
    assert figures['safe'] < STATE_TIMEOUT + ON_THE_WAY


def test_two_planners_run_by_mistake(ros: Ros, rig: PendulumRig) -> None:
    began = rig.now
    other = ros.start('tdm_planner.nodes.planner', rig.parameters('planner'), namespace='faults')
    rig.wait(lambda: rig.says('tracker', '2 planners publish /faults/trajectory'))
    detected = rig.now - began
    rig.wait(lambda: rig.says('planner', '2 planners publish /faults/plan_summary'))
    for process in (rig.processes['planner'], rig.processes['tracker'], other):
        rig.wait(lambda process=process: '2 planners publish' in process.output)
    # A request reaches both: each plans, each publishes.
    rig.fall()
    ros.request('/faults/plan', Trigger)
    rig.wait(lambda: ': plan 1: ' in other.output)
    held = rig.held_since(rig.now)
    refused = rig.processes['tracker'].output.count('trajectory refused')
    note('two planners', detected=detected, refused=float(refused))
    assert rig.followed[-1].points
    assert other.end() == 0
    rig.wait(lambda: not rig.says('tracker', 'planners publish'))
    assert rig.lean(held + 0.5) < 0.2


def test_of_two_planners_the_plan_that_starts_last_is_followed(ros: Ros, rig: PendulumRig) -> None:
    publisher = ros.publisher('/faults/trajectory', JointTrajectory, LATCHED)
    rig.plan()
    rig.wait(lambda: nanoseconds_of(rig.followed[-1].header.stamp) == rig.newest_start)
    other = copy.deepcopy(rig.plans[-1])
    other.header.stamp = to_stamp(rig.newest_start - 100_000_000)
    publisher.publish(other)
    refusal = "it starts 0.1 s before the one in force; of 2 planners' plans"
    rig.wait(lambda: rig.said('tracker', refusal))
    assert nanoseconds_of(rig.followed[-1].header.stamp) == rig.newest_start + 100_000_000
    ros.node.destroy_publisher(publisher)
    rig.wait(lambda: rig.figure('tracker', 'planners') == 1)


@again
def test_busy_processes_take_the_processors(rig: PendulumRig, repetition: int) -> None:
    """Two for every core: the motion follows the clock all the same."""
    hogs = [
        subprocess.Popen([sys.executable, '-c', 'while True: pass'])
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    try:
        began = rig.now
        seen, sent = len(rig.states), len(rig.commands)
        rig.fall()
        held = rig.held_since(began + 0.1)
        periods = np.diff([seconds_of(s.header.stamp) for s in rig.states[seen:]])
        gaps = np.diff([seconds_of(c.header.stamp) for c in rig.commands[sent:]])
        note(
            'processors taken',
            recovered=held - began,
            states_p99=float(np.percentile(periods, 99)),
            commands_p99=float(np.percentile(gaps, 99)),
            longest_gap=float(max(periods.max(), gaps.max())),
        )
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()

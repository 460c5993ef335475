# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Nodes that are killed, restarted, started twice or starved, over real DDS.

What goes on, what falls safe, what recovers; the figures are those of docs/reliability.md.
"""

from __future__ import annotations

from collections.abc import Iterator
import copy
from functools import partial
import json
import os
import subprocess
import sys
import time

from fault_figures import EVERYTHING, note
import numpy as np
from process_rig import COMMAND_TIMEOUT, ProcessRig, STATE_TIMEOUT
import pytest
from ros_harness import NodeProcess, Ros
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, seconds_of, to_stamp
from trajectory_msgs.msg import JointTrajectory

ON_THE_WAY = 0.1  # s that messages may take on a busy machine
pytestmark = pytest.mark.skipif(
    not EVERYTHING, reason='kills and starves processes for minutes: set TDM_FAULTS=all'
)
again = pytest.mark.parametrize('repetition', range(5 if EVERYTHING else 1))


@pytest.fixture(scope='module')
def rig(ros: Ros) -> ProcessRig:
    """Return a pendulum that is held upright, and planned for anew where it is not."""
    made = ProcessRig(
        ros, 'faults', tracker={'replan.on_deviation': True}, planner={'replan.rate': 5.0}
    )
    made.held_since(made.plan())
    return made


@pytest.fixture(autouse=True)
def never_stale(rig: ProcessRig) -> Iterator[None]:
    """Whatever happens, no command acts for longer than `command_timeout`."""
    rig.held_since(rig.now)
    yield
    assert rig.longest_torque() < COMMAND_TIMEOUT + ON_THE_WAY


@again
@pytest.mark.parametrize('moment', ['holding', 'tracking'])
def test_a_plant_is_killed_and_restarted(rig: ProcessRig, moment: str, repetition: int) -> None:
    if moment == 'tracking':
        rig.fall()
    rig.wait(lambda: rig.says('tracker', moment))
    killed = rig.kill('plant')
    rig.wait(lambda: rig.says('tracker', 'older than state_timeout'))
    rig.wait(lambda: rig.commands[-1].effort[0] == 0.0)
    safe = rig.last_command() - killed
    seen = len(rig.states)
    rig.start('plant')
    rig.wait(lambda: len(rig.states) > seen)
    back = seconds_of(rig.states[seen].header.stamp)
    assert rig.last_command() < back, 'nothing may be commanded without a state'
    held = rig.held_since(back)
    note(f'plant killed, {moment}', safe=safe, recovered=held - back)
    assert safe < STATE_TIMEOUT + ON_THE_WAY


@again
def test_a_tracker_is_killed_and_restarted_in_mid_swing(rig: ProcessRig, repetition: int) -> None:
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking'))
    killed = rig.kill('tracker')
    rig.wait(lambda: rig.now > killed + 1.0)
    safe = rig.last_torque(killed)
    restarted = time.time()
    rig.start('tracker')
    held = rig.held_since(restarted)
    note('tracker killed in mid-swing', safe=safe, recovered=held - restarted)
    assert safe < COMMAND_TIMEOUT + ON_THE_WAY


def told_of_another(process: NodeProcess) -> bool:
    return '2 planners publish' in process.output


def test_two_planners_run_by_mistake(ros: Ros, rig: ProcessRig) -> None:
    started = time.time()
    other = ros.start('tdm_planner.nodes.planner', rig.parameters['planner'], namespace='faults')
    rig.wait(lambda: rig.says('tracker', '2 planners publish /faults/trajectory'))
    detected = time.time() - started
    rig.wait(lambda: rig.says('planner', '2 planners publish /faults/plan_summary'))
    for process in (rig.processes['planner'], rig.processes['tracker'], other):
        rig.wait(partial(told_of_another, process))
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


def test_of_two_planners_the_plan_that_starts_last_is_followed(ros: Ros, rig: ProcessRig) -> None:
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
def test_a_planner_is_killed_while_it_plans_and_restarted(
    ros: Ros, rig: ProcessRig, repetition: int
) -> None:
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking') or rig.says('tracker', 'waiting'))
    ros.request('/faults/plan', Trigger)
    rig.wait(lambda: rig.says('planner', 'planning'))
    rig.kill('planner')
    fell = rig.now
    held = rig.held_since(fell)
    accepted = rig.figure('tracker', 'trajectories accepted')
    refused = rig.figure('tracker', 'trajectories refused')
    plan = rig.followed[-1]
    rig.plans.clear()
    restarted = time.time()
    rig.start('planner')
    rig.wait(lambda: bool(rig.plans))
    back = time.time()
    rig.wait(lambda: rig.says('planner', 'plan 1 in force') or rig.says('planner', 'publish'))
    late = ros.subscribe('/faults/trajectory', JointTrajectory, LATCHED)
    summaries = ros.subscribe('/faults/plan_summary', String, LATCHED)
    rig.wait(lambda: late and summaries)
    assert late[-1].header.stamp == plan.header.stamp
    assert [p.positions for p in late[-1].points] == [p.positions for p in plan.points]
    assert [p.effort for p in late[-1].points] == [p.effort for p in plan.points]
    assert json.loads(summaries[-1].data)['verification']['ok']
    ros.spin_for(0.5)
    assert rig.figure('tracker', 'trajectories accepted') == accepted
    assert rig.figure('tracker', 'trajectories refused') == refused
    assert rig.lean(held + 0.5) < 0.2
    note('planner killed while planning', safe=0.0, recovered=back - restarted)


def test_the_restarted_planner_plans_on_request(ros: Ros, rig: ProcessRig) -> None:
    done, answer = ros.trigger('/faults/plan')
    assert done, answer


@again
def test_busy_processes_take_the_processors(rig: ProcessRig, repetition: int) -> None:
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

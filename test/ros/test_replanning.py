# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Replanning and repeated requests over DDS: planner, tracker and plant of a pendulum."""

from __future__ import annotations

from collections.abc import Iterator
import itertools
import json
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import read_joints, seconds_of
from tdm_planner.plant_kind import PENDULUM
from trajectory_msgs.msg import JointTrajectory

PLANNER = 'tdm_planner.nodes.planner'
STRONG = {'limits.torque': 0.09}  # N m; upright after .4 s
NOT_TAKEN, REJECTED = 'the last plan was rejected by', 'trajectory rejected'


class Rig:
    """Planner, tracker and plant of a pendulum that hangs at rest, and what they say."""

    def __init__(
        self,
        ros: Stepped,
        namespace: str,
        planner: dict[str, Any],
        tracker: dict[str, Any] | None = None,
        plant: dict[str, Any] | None = None,
    ) -> None:
        self.ros, self.namespace = ros, namespace
        self.align()
        self.plant = self.start('tdm_sim.pendulum_plant', plant or {})
        self.tracker = self.start('tdm_planner.nodes.tracker', tracker or {})
        self.planner = self.start(PLANNER, planner)
        self.states = ros.subscribe(f'/{namespace}/joint_states', JointState)
        self.plans = ros.subscribe(f'/{namespace}/trajectory', JointTrajectory, LATCHED)
        self.summaries = ros.subscribe(f'/{namespace}/plan_summary', String, LATCHED)
        assert ros.spin_until(lambda: bool(self.states))
        self.align()

    def align(self) -> None:
        """Go on at a tenth of a second, however long it took that nodes have met."""
        self.ros.spin_for((10**8 - self.ros.now % 10**8) * 1e-9)

    def start(self, module: str, parameters: dict[str, Any]) -> Any:
        return self.ros.start(module, {**STRONG, **parameters}, namespace=self.namespace)

    def plan(self) -> dict[str, Any]:
        done, answer = self.ros.trigger(f'/{self.namespace}/plan')
        assert done, answer
        return answer

    def push(self, impulse: float) -> None:
        node = f'/{self.namespace}/pendulum_plant'
        assert self.ros.set_parameters(node, disturbance__impulse=impulse) == ['']
        assert self.ros.call(f'/{self.namespace}/push', Trigger).success

    def angle(self, state: JointState) -> float:
        return read_joints(PENDULUM.measured, state, ['theta'])['theta']

    def upright_for(self, seconds: float) -> bool:
        """Whether the pendulum has been upright so long."""
        newest = seconds_of(self.states[-1].header.stamp)
        for state in reversed(self.states):
            if seconds_of(state.header.stamp) < newest - seconds:
                return True
            if abs(math.remainder(self.angle(state), math.tau)) > 0.1:
                return False
        return False

    def stands_up(self) -> bool:
        return self.ros.spin_until(lambda: self.upright_for(0.5))

    def end(self) -> None:
        for node in (self.planner, self.tracker, self.plant):
            node.end_cleanly()


# The first plan begins .6 s after its request; the last request waits for it to begin.
@pytest.mark.parametrize('pause', [0.2, 0.5])
def test_the_last_of_several_requests_is_followed(ros: Stepped, pause: float) -> None:
    namespace = f'second_{round(100 * pause)}'
    rig = Rig(ros, namespace, {'start.delay': 0.6, 'start.max_age': 5.0})
    rig.plan()
    ros.spin_for(pause)
    rig.plan()
    assert rig.stands_up(), rig.tracker.output
    assert 'stopped' not in rig.tracker.output
    assert 'rejected' not in rig.tracker.output
    rig.end()


def test_a_planner_started_again_takes_the_plan_back_and_a_second_one_is_told_of(
    ros: Stepped,
) -> None:
    rig = Rig(ros, 'again', {'start.delay': 0.2})
    rig.plan()
    assert ros.spin_until(lambda: 'tracking' in rig.tracker.output)
    rig.planner.end_cleanly()
    rig.planner = rig.start(PLANNER, {})
    assert ros.spin_until(lambda: len(rig.plans) == 2), rig.planner.output
    assert rig.plans[1] == rig.plans[0]
    assert 'recovered active plan 1 from the trackers' in rig.planner.output
    rig.plant.end_cleanly()
    given = {**STRONG, 'start.source': 'parameters'}
    own = ['-r', 'plan:=plan_of_the_second']
    second = ros.start(PLANNER, given, namespace='again', arguments=own)
    assert ros.trigger('/again/plan_of_the_second')[0]
    ros.settle()
    assert "another planner's plan is active: plan 1 is no longer reviewed" in rig.planner.output
    warning = '2 planners publish /again/plan_summary: trackers follow'
    assert ros.spin_until(lambda: warning in rig.planner.output)
    second.end_cleanly()
    rig.end()


numbers = itertools.count()


@pytest.fixture
def rig(ros: Stepped) -> Iterator[Rig]:
    made = Rig(
        ros,
        f'replanning{next(numbers)}',
        {'replan.rate': 10.0, 'replan.delay': 0.2, 'start.delay': 0.3},
        {'replan.on_deviation': True},
        {'mismatch': 0.03, 'noise.theta': 0.001, 'noise.theta_dot': 0.05},
    )
    yield made
    made.end()


def test_a_pushed_pendulum_is_planned_for_anew_and_held(ros: Stepped, rig: Rig) -> None:
    """With the parameters that its plan was asked for, not the node's; so when it falls."""
    own = [Parameter('torque_reserve', value=0.25).to_parameter_msg()]
    request = SetParametersAtomically.Request(parameters=own)
    asked = ros.call(f'/{rig.namespace}/plan_with', SetParametersAtomically, request)
    assert asked.result.successful, asked.result.reason
    ros.settle()
    begins = seconds_of(rig.plans[0].header.stamp)
    assert ros.spin_until(lambda: seconds_of(rig.states[-1].header.stamp) > begins + 0.15)
    rig.push(1.5e-3)
    assert rig.stands_up(), rig.planner.output
    assert len(rig.plans) > 1, rig.planner.output
    # The tracker takes the plans made on the way, or rightly refuses one that was made before.
    assert rig.tracker.output.count('accepted') >= len(rig.plans) - 1
    assert rig.tracker.output.count(REJECTED) <= 1
    # Every one was verified, and starts where the pendulum was.
    summaries = [json.loads(message.data) for message in rig.summaries]
    assert [summary['plan_id'] for summary in summaries] == list(range(1, len(rig.plans) + 1))
    assert all(summary['verification']['ok'] for summary in summaries)
    assert {summary['parameters']['torque_reserve'] for summary in summaries} == {0.25}
    assert 'the problem has changed' not in rig.planner.output
    stamps = np.array([seconds_of(state.header.stamp) for state in rig.states])
    angles = np.array([rig.angle(state) for state in rig.states])
    last = rig.plans[-1]
    measured = float(np.interp(seconds_of(last.header.stamp), stamps, angles))
    assert abs(math.remainder(last.points[0].positions[0] - measured, math.tau)) < 0.3
    # Upright there are no more plans until it falls.
    count = len(rig.plans)
    ros.spin_for(0.5)
    assert len(rig.plans) == count
    assert rig.upright_for(0.5)
    rig.push(-4e-3)
    assert ros.spin_until(lambda: len(rig.plans) > count), rig.planner.output
    assert rig.stands_up(), rig.planner.output
    assert rig.planner.output.count(NOT_TAKEN) <= rig.tracker.output.count(REJECTED)


def test_a_plan_that_the_tracker_refuses_is_found_not_to_be_active(ros: Stepped, rig: Rig) -> None:
    """
    Upright, the tracker is offered a swing-up from hanging: it goes on holding.

    On the way requests are answered though the plan is reviewed.
    """
    rig.plan()
    assert ros.spin_until(lambda: 'tracking' in rig.tracker.output)
    for _ in range(3):
        done, answer = ros.trigger(f'/{rig.namespace}/plan')
        assert done or answer['code'] != 'BUSY', answer
        ros.spin_for(0.03)
    assert rig.stands_up()
    ros.spin_for(0.5)
    assert ros.set_parameters(f'/{rig.namespace}/planner', start__source='parameters') == ['']
    told, rejected = (rig.planner.output.count(NOT_TAKEN), rig.tracker.output.count(REJECTED))
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
    answer = rig.plan()
    sentence = f'plan {answer["plan_id"]} is not followed by pendulum: the tracker says why'
    ros.spin_for(0.5)  # it begins after .3 s, and trackers have another .3 s to tell
    assert rig.tracker.output.count(REJECTED) > rejected
    assert sentence not in rig.planner.output
    assert ros.spin_until(lambda: rig.planner.output.count(NOT_TAKEN) > told), rig.planner.output
    ros.spin_for(0.5)
    assert sentence in rig.planner.output
    messages = [s.message for array in diagnostics for s in array.status]
    assert any(sentence in message for message in messages)
    assert rig.upright_for(0.5)


def test_for_a_tracker_that_was_deactivated_nothing_is_planned(ros: Stepped, rig: Rig) -> None:
    rig.plan()
    assert rig.stands_up()
    count, before = len(rig.plans), rig.planner.output.count('new plan')
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert ros.call(f'/{rig.namespace}/tracker/change_state', ChangeState, request).success
    said = 'no replanning: no tracker is active for pendulum'
    assert ros.spin_until(lambda: said in rig.planner.output), rig.planner.output
    # The pendulum falls, which would be a reason for a new plan.
    assert ros.spin_until(lambda: not rig.upright_for(0.2))
    ros.spin_for(0.5)
    assert len(rig.plans) <= count + 1  # one review may have been under way
    assert rig.planner.output.count('new plan') <= before + 1
    assert rig.planner.output.count(said) == 1

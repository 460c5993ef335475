# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Replanning over DDS: planner, tracker and plant, a push on the way, a goal that moves."""

from __future__ import annotations

import json
import math
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
from ros_harness import Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import joint_motion, LATCHED, PENDULUM_JOINTS, seconds_of
from trajectory_msgs.msg import JointTrajectory

LIMIT = 0.02  # N m; the slow swing
WEAK = {'limits.torque': LIMIT}


NOT_TAKEN, REFUSED = 'was not taken over by', 'trajectory refused'


class Rig:
    """Planner, tracker and plant of a pendulum, and what they say."""

    def __init__(self, ros: Ros, namespace: str) -> None:
        self.ros, self.namespace = ros, namespace
        plant = {**WEAK, 'mismatch': 0.03, 'noise.theta': 0.001, 'noise.theta_dot': 0.05}
        tracker = {**WEAK, 'replan.on_deviation': True}
        planner = {**WEAK, 'replan.rate': 5.0, 'replan.delay': 0.3, 'start.delay': 1.5}
        planner['start.max_age'] = 5.0  # the planner may meet the plant later than the test does
        self.plant = self.start('tdm_sim.pendulum_plant', {**plant, 'disturbance.impulse': 1e-3})
        self.tracker = self.start('tdm_planner.nodes.tracker', tracker)
        self.planner = self.start('tdm_planner.nodes.planner', planner)
        self.states = ros.subscribe(f'/{namespace}/joint_states', JointState)
        self.commands = ros.subscribe(f'/{namespace}/joint_command', JointState)
        self.plans = ros.subscribe(f'/{namespace}/trajectory', JointTrajectory, LATCHED)
        self.summaries = ros.subscribe(f'/{namespace}/plan_summary', String, LATCHED)

    def start(self, module: str, parameters: dict[str, Any]) -> Any:
        return self.ros.start(module, parameters, namespace=self.namespace)

    def upright_for(self, seconds: float) -> bool:
        """Whether the pendulum has been upright so long."""
        newest = seconds_of(self.states[-1].header.stamp)
        for state in reversed(self.states):
            if seconds_of(state.header.stamp) < newest - seconds:
                return True
            theta = joint_motion(state, PENDULUM_JOINTS)[0]
            if abs(math.remainder(float(theta), math.tau)) > 0.1:
                return False
        return False


@pytest.fixture(scope='module')
def rig(ros: Ros) -> Rig:
    made = Rig(ros, 'replanning')
    assert ros.spin_until(lambda: bool(made.states) and bool(made.commands), 20.0)
    return made


def test_a_pushed_pendulum_is_planned_for_anew_and_held(ros: Ros, rig: Rig) -> None:
    done, answer = ros.trigger('/replanning/plan')
    assert done, answer
    assert ros.spin_until(lambda: bool(rig.plans))
    begins = seconds_of(rig.plans[0].header.stamp)
    ros.spin_until(lambda: seconds_of(rig.states[-1].header.stamp) > begins + 0.7, 10.0)
    assert ros.call('/replanning/push', Trigger).success
    assert ros.spin_until(lambda: rig.upright_for(2.0), 30.0), rig.planner.output
    assert len(rig.plans) > 1, rig.planner.output


def test_the_tracker_takes_the_plans_made_on_the_way(rig: Rig) -> None:
    # A plan made from a state measured just before the push is rightly refused.
    assert rig.tracker.output.count('accepted') >= len(rig.plans) - 1
    assert rig.tracker.output.count('refused') <= 1


def test_every_plan_on_the_way_was_verified_and_starts_where_the_pendulum_was(rig: Rig) -> None:
    summaries = [json.loads(message.data) for message in rig.summaries]
    assert [summary['plan_id'] for summary in summaries] == list(range(1, len(rig.plans) + 1))
    assert all(summary['verification']['ok'] for summary in summaries)
    stamps = np.array([seconds_of(state.header.stamp) for state in rig.states])
    angles = np.array([joint_motion(state, PENDULUM_JOINTS)[0] for state in rig.states])
    last = rig.plans[-1]
    measured = float(np.interp(seconds_of(last.header.stamp), stamps, angles))
    assert abs(math.remainder(last.points[0].positions[0] - measured, math.tau)) < 0.3


def test_upright_there_are_no_more_plans(ros: Ros, rig: Rig) -> None:
    count = len(rig.plans)
    ros.spin_for(2.0)
    assert len(rig.plans) == count
    assert rig.upright_for(2.0)


def test_it_is_swung_up_again_from_wherever_it_falls(ros: Ros, rig: Rig) -> None:
    count = len(rig.plans)
    assert ros.set_parameters('/replanning/pendulum_plant', disturbance__impulse=2e-3) == ['']
    assert ros.call('/replanning/push', Trigger).success
    assert ros.spin_until(lambda: len(rig.plans) > count, 10.0), rig.planner.output
    assert ros.spin_until(lambda: rig.upright_for(2.0), 30.0), rig.planner.output


def test_no_plan_is_thought_refused_that_was_accepted(rig: Rig) -> None:
    assert rig.planner.output.count(NOT_TAKEN) <= rig.tracker.output.count(REFUSED)


def test_a_request_is_answered_though_the_plan_is_reviewed(ros: Ros, rig: Rig) -> None:
    for _ in range(5):
        done, answer = ros.trigger('/replanning/plan')
        assert done or answer['code'] != 'BUSY', answer


def test_a_plan_that_the_tracker_refuses_is_found_not_to_be_in_force(ros: Ros, rig: Rig) -> None:
    """Upright, the tracker is offered a swing-up from hanging: it goes on holding."""
    assert ros.spin_until(lambda: rig.upright_for(1.0), 30.0)
    assert ros.set_parameters('/replanning/planner', start__source='parameters') == ['']
    told, refused = (rig.planner.output.count(NOT_TAKEN), rig.tracker.output.count(REFUSED))
    done, answer = ros.trigger('/replanning/plan')
    assert done, answer
    assert ros.spin_until(lambda: rig.tracker.output.count(REFUSED) > refused, 10.0)
    assert ros.spin_until(lambda: rig.planner.output.count(NOT_TAKEN) > told, 10.0), (
        rig.planner.output
    )
    ros.spin_for(2.0)
    assert rig.upright_for(2.0)


def test_for_a_tracker_that_was_deactivated_nothing_is_planned(ros: Ros, rig: Rig) -> None:
    assert ros.set_parameters('/replanning/planner', start__source='measured') == ['']
    count = len(rig.plans)
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert ros.call('/replanning/tracker/change_state', ChangeState, request).success
    said = 'no replanning: no tracker is active for pendulum'
    assert ros.spin_until(lambda: said in rig.planner.output), rig.planner.output
    before = rig.planner.output.count('new plan')
    # The pendulum falls, which would be a reason for a new plan.
    assert ros.spin_until(lambda: not rig.upright_for(0.2), 30.0)
    ros.spin_for(2.0)
    assert len(rig.plans) <= count + 1  # one review may have been under way
    assert rig.planner.output.count('new plan') <= before + 1
    assert rig.planner.output.count(said) == 1

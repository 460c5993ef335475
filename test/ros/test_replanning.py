# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Replanning and repeated requests over DDS: planner, tracker and plant of a pendulum."""

import json
import math

import numpy as np
from pendulum_rig import PendulumRig
import pytest
from stepped_ros import Stepped
from tdm_planner.nodes.reading import seconds_of

STRONG = {'limits.torque': 0.09}  # N m; upright after .4 s
NOT_TAKEN, REJECTED = 'is not followed by pendulum', 'trajectory rejected'


class Rig(PendulumRig):
    """A pendulum that hangs at rest, and what its planner says of plans."""

    def __init__(self, ros: Stepped, namespace: str, **parameters: dict) -> None:
        super().__init__(ros, namespace, **parameters)
        self.summaries = self.hear('plan_summary')
        # Go on at a tenth of a second, however long it took that nodes have met.
        ros.spin_for((10**8 - ros.now % 10**8) * 1e-9)

    def told(self, role: str) -> str:
        return str(self.processes[role].output)

    def push(self, impulse: float) -> None:
        self.set('pendulum_plant', disturbance__impulse=impulse)
        self.trigger('push')

    def upright_for(self, seconds: float) -> bool:
        for state in reversed(self.states):
            if seconds_of(state.header.stamp) < self.now - seconds:
                return True
            if abs(math.remainder(state.position[0], math.tau)) > 0.1:
                return False
        return False

    def stands_up(self) -> bool:
        return self.ros.spin_until(lambda: self.upright_for(0.5))


def test_a_planner_started_again_takes_the_plan_back_and_a_second_one_is_told_of(ros):
    rig = Rig(ros, 'again', planner={'start.delay': 0.2})
    rig.plan()
    assert ros.spin_until(lambda: 'tracking' in rig.told('tracker'))
    rig.processes['planner'].end_cleanly()
    rig.start('planner')
    assert ros.spin_until(lambda: len(rig.plans) == 2), rig.told('planner')
    assert rig.plans[1] == rig.plans[0]
    assert 'recovered active plan 1 from the trackers' in rig.told('planner')
    rig.processes['pendulum_plant'].end_cleanly()
    own = ['-r', 'plan:=plan_of_the_second']
    ros.start('planner', {**STRONG, 'start.source': 'parameters'}, 'again', own)
    rig.trigger('plan_of_the_second')
    warning = '2 planners publish /again/plan_summary: trackers follow'
    assert ros.spin_until(lambda: warning in rig.told('planner'))


@pytest.fixture
def rig(ros: Stepped) -> Rig:
    planner = {'replan.rate': 10.0, 'replan.delay': 0.2, 'start.delay': 0.3}
    plant = {'mismatch': 0.03, 'noise.theta': 0.001, 'noise.theta_dot': 0.05}
    return Rig(ros, '', planner=planner, pendulum_plant=plant)


def test_a_pushed_pendulum_is_planned_for_anew_and_held(ros, rig):
    """With the parameters that its plan was asked for, not the node's; so when it falls."""
    result = ros.set_all(f'{rig.space}/plan_with', torque_reserve=0.25)
    assert result.successful, result.reason
    ros.settle()
    begins = seconds_of(rig.plans[0].header.stamp)
    assert ros.spin_until(lambda: seconds_of(rig.states[-1].header.stamp) > begins + 0.15)
    rig.push(1.5e-3)
    assert rig.stands_up(), rig.told('planner')
    assert len(rig.plans) > 1, rig.told('planner')
    # The tracker takes the plans made on the way, or rightly refuses one that was made before.
    assert rig.told('tracker').count('accepted') >= len(rig.plans) - 1
    assert rig.told('tracker').count(REJECTED) <= 1
    # Every one was verified, and starts where the pendulum was.
    summaries = [json.loads(message.data) for message in rig.summaries]
    assert [summary['plan_id'] for summary in summaries] == list(range(1, len(rig.plans) + 1))
    assert all(summary['verification']['ok'] for summary in summaries)
    assert {summary['parameters']['torque_reserve'] for summary in summaries} == {0.25}
    starts = [seconds_of(plan.header.stamp) for plan in rig.plans]
    assert min(np.diff(starts)) > 0.2 - 1e-9  # replan.delay
    assert 'the problem has changed' not in rig.told('planner')
    stamps = np.array([seconds_of(state.header.stamp) for state in rig.states])
    angles = np.array([state.position[0] for state in rig.states])
    last = rig.plans[-1]
    measured = float(np.interp(seconds_of(last.header.stamp), stamps, angles))
    assert abs(math.remainder(last.points[0].positions[0] - measured, math.tau)) < 0.3
    # Upright there are no more plans until it falls.
    assert ros.silent(rig.plans, 0.5)
    assert rig.upright_for(0.5)
    count = len(rig.plans)
    rig.push(-4e-3)
    assert ros.spin_until(lambda: len(rig.plans) > count), rig.told('planner')
    assert rig.stands_up(), rig.told('planner')
    assert rig.told('planner').count(NOT_TAKEN) <= rig.told('tracker').count(REJECTED)


def test_a_request_while_the_tracker_brakes_begins_where_that_leads(ros):
    plant = dict.fromkeys(('noise.theta', 'noise.psi', 'noise.theta_dot', 'noise.psi_dot'), 0.0)
    tracker = {'planner_service': 'nobody', 'replan.on_deviation': True}
    rig = Rig(ros, 'braked', pendulum_plant=plant, tracker=tracker)
    rig.plan()
    assert rig.stands_up()
    rig.push(1.5e-3)
    assert ros.spin_until(lambda: rig.said('tracker', 'recovering'))
    ros.spin_for(0.2)
    rig.plan()
    assert rig.stands_up(), rig.told('tracker')
    assert rig.told('tracker').count('accepted') == 2
    assert REJECTED not in rig.told('tracker')


def test_a_plan_that_the_tracker_refuses_is_found_not_to_be_active(ros, rig):
    """Upright, it is offered a swing-up; on the way requests are answered, reviews or not."""
    rig.plan()
    assert ros.spin_until(lambda: 'tracking' in rig.told('tracker'))
    for _ in range(3):
        done, answer = ros.trigger(f'{rig.space}/plan')
        assert done or answer['code'] != 'BUSY', answer
        ros.spin_for(0.03)
    assert rig.stands_up()
    ros.spin_for(0.5)
    rig.set('planner', start__source='parameters')
    rejected = rig.told('tracker').count(REJECTED)
    rig.plan()
    number = json.loads(rig.summaries[-1].data)['plan_id']
    sentence = f'plan {number} is not followed by pendulum: the tracker says why'
    ros.spin_for(0.5)  # it begins after .3 s, and trackers have another .3 s to tell
    assert rig.told('tracker').count(REJECTED) > rejected
    assert sentence not in rig.told('planner')
    assert ros.spin_until(lambda: sentence in rig.told('planner')), rig.told('planner')
    ros.spin_for(0.5)
    assert rig.said('planner', sentence)
    assert rig.upright_for(0.5)
    # For a tracker that was deactivated nothing is planned.
    rig.set('planner', start__source='measured')
    count, before = len(rig.plans), rig.told('planner').count('new plan')
    assert ros.change(f'{rig.space}/tracker', 'deactivate')
    said = 'no replanning: no tracker is active for pendulum'
    assert ros.spin_until(lambda: said in rig.told('planner')), rig.told('planner')
    # The pendulum falls, which would be a reason for a new plan.
    assert ros.spin_until(lambda: not rig.upright_for(0.2))
    ros.spin_for(0.5)
    assert len(rig.plans) <= count + 1  # one review may have been under way
    assert rig.told('planner').count('new plan') <= before + 1
    assert rig.told('planner').count(said) == 1

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The tracker over real DDS: with a scripted state source, and with the simulated pendulum."""

from __future__ import annotations

import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, pendulum_message, to_stamp
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory

LIMIT = 0.02  # the slow swing: a busy machine may stall a process for a while
LATER = 1.0  # s from publishing to the start


@pytest.fixture(scope='module')
def plan() -> Trajectory:
    values = {'limits.torque': LIMIT, 'torque_reserve': 0.3}
    solution = build(PendulumSwingUp, values).solve(deadline=10.0)
    plant = build(PendulumSwingUp, values).plant
    return solution.trajectory.with_rates(plant.derivative)


def message(plan: Trajectory, delay: float = LATER) -> JointTrajectory:
    return pendulum_message(plan, to_stamp(time.time_ns() + round(delay * 1e9)))


class Bench:
    """A tracker in a namespace of its own, and what it says."""

    def __init__(self, ros: Ros, namespace: str, **parameters: Any) -> None:
        self.ros, self.namespace = ros, namespace
        dotted = {name.replace('__', '.'): value for name, value in parameters.items()}
        self.parameters = {'limits.torque': LIMIT, **dotted}
        self.commands = ros.subscribe(f'/{namespace}/joint_command', JointState)
        self.errors = ros.subscribe(f'/{namespace}/tracking_error', JointState)
        self.diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
        self.tracker = self.start()
        self.plans = ros.publisher(f'/{namespace}/trajectory', JointTrajectory, LATCHED)
        assert ros.spin_until(lambda: bool(self.commands))

    def start(self) -> NodeProcess:
        return self.ros.start(
            'tdm_planner.nodes.tracker', self.parameters, namespace=self.namespace
        )

    def statuses(self) -> list[Any]:
        name = f'/{self.namespace}/tracker: tracking'
        return [s for array in self.diagnostics for s in array.status if s.name == name]

    def drives(self) -> bool:
        """Whether the simulated plant receives commands."""
        plant = f'/{self.namespace}/pendulum_plant'
        found = [s for a in self.diagnostics for s in a.status if s.hardware_id == plant]
        figures = {item.key: item.value for status in found[-1:] for item in status.values}
        return float(figures.get('commands accepted', 0)) > 0

    def says(self, *texts: str, level: int | None = None) -> bool:
        """Whether the newest diagnostic says so within a few seconds."""
        return self.ros.spin_until(lambda: self.said(*texts, level=level))

    def said(self, *texts: str, level: int | None = None) -> bool:
        """Whether the newest diagnostic says so."""
        return any(
            all(text in status.message for text in texts) and level in (None, status.level[0])
            for status in self.statuses()[-1:]
        )


@pytest.fixture(scope='module')
def bench(ros: Ros) -> Bench:
    """Return a tracker without a plant: the test publishes the states."""
    return Bench(ros, 'scripted')


@pytest.fixture(scope='module')
def states(ros: Ros, bench: Bench) -> Any:
    return ros.publisher('/scripted/joint_states', JointState)


def publish_state(states: Any, theta: float = math.pi, **changes: Any) -> None:
    content = {
        'name': ['disk', 'pendulum'],
        'position': [0.0, theta],
        'velocity': [0.0, 0.0],
        'effort': [0.0, 0.0],
        **changes,
    }
    state = JointState(**content)
    state.header.stamp = to_stamp(time.time_ns())
    states.publish(state)


def keep_publishing(ros: Ros, states: Any, seconds: float, theta: float = math.pi) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        publish_state(states, theta)
        ros.spin_for(0.01)


def says_meanwhile(
    ros: Ros, bench: Bench, states: Any, text: str, level: int | None = None
) -> bool:
    return ros.publish_until(lambda: publish_state(states), lambda: bench.said(text, level=level))


def test_the_first_second_without_a_state_is_no_error(ros: Ros) -> None:
    """The middleware takes its time; the plant publishes before the tracker starts."""
    states = ros.node.create_publisher(JointState, '/patient/joint_states', 10)
    parameters = {'limits.torque': LIMIT, 'state_timeout': 10.0}
    tracker = ros.start('tdm_planner.nodes.tracker', parameters, namespace='patient')
    status = ros.subscribe('/diagnostics', DiagnosticArray, 50)

    def idle() -> bool:
        found = [s for a in status for s in a.status if s.name == '/patient/tracker: tracking']
        return bool(found) and found[-1].message == 'idle' and states.get_subscription_count() > 0

    assert ros.publish_until(lambda: publish_state(states), idle)
    assert 'waiting for the first state' in tracker.output
    assert '[ERROR]' not in tracker.output
    tracker.end_cleanly()


def test_a_state_that_does_not_come_is_an_error_after_the_first_second(bench: Bench) -> None:
    assert bench.says('no state has been received', level=2)
    before, _, after = bench.tracker.output.partition('waiting for the first state')
    assert '[ERROR]' not in before
    assert after.count('[ERROR]') == 1


def test_a_state_that_has_gone_stale_is_an_error_at_once(ros: Ros) -> None:
    bench, states = Bench(ros, 'stale'), ros.publisher('/stale/joint_states', JointState)
    keep_publishing(ros, states, 0.3)
    assert bench.says('older than state_timeout', level=2)
    bench.tracker.end_cleanly()


def test_without_a_state_nothing_is_commanded(bench: Bench) -> None:
    assert bench.says('no state has been received', level=2)
    assert list(bench.commands[-1].name) == ['disk']
    assert all(command.effort[0] == 0.0 for command in bench.commands)


def test_states_that_cannot_be_read_are_left_out(ros: Ros, bench: Bench, states: Any) -> None:
    def publish() -> None:
        publish_state(states, name=['arm', 'pendulum'])
        publish_state(states, position=[0.0])
        publish_state(states, velocity=[0.0, math.nan])

    assert ros.publish_until(publish, lambda: 'state left out' in bench.tracker.output)
    assert bench.says('no state has been received', level=2)
    assert says_meanwhile(ros, bench, states, 'idle', level=0)


@pytest.mark.parametrize(
    ('spoil', 'reason'),
    [
        (lambda m: m.points.clear(), 'at least two'),
        (lambda m: setattr(m, 'joint_names', ['disk', 'arm']), 'pendulum'),
        (lambda m: setattr(m.points[3], 'positions', [1.0]), 'point 3'),
        (lambda m: setattr(m.points[3], 'velocities', [math.nan, 0.0]), 'finite'),
        (
            lambda m: setattr(m.points[4], 'time_from_start', m.points[3].time_from_start),
            'increase',
        ),
        (lambda m: setattr(m.header, 'stamp', to_stamp(time.time_ns() - 10**11)), 'past'),
        (lambda m: [p.positions.__setitem__(0, 2.0) for p in m.points], 'tolerance.start'),
    ],
)
def test_trajectories_are_refused_with_a_reason(
    ros: Ros, bench: Bench, states: Any, plan: Trajectory, spoil: Any, reason: str
) -> None:
    spoilt = message(plan)
    spoil(spoilt)
    keep_publishing(ros, states, 0.05)
    bench.plans.publish(spoilt)
    assert says_meanwhile(ros, bench, states, reason)


@pytest.mark.parametrize('data', [b'\0\1\0\0', b'\0\1\0\0' + bytes(12), b'\xff' * 40])
def test_bytes_that_are_no_trajectory_are_refused(
    ros: Ros, bench: Bench, states: Any, data: bytes
) -> None:
    """Whatever a faulty node sends, the tracker stays."""
    count = bench.tracker.output.count('trajectory refused: ')
    bench.plans.publish(data)
    assert ros.spin_until(lambda: bench.tracker.output.count('trajectory refused: ') > count)
    assert says_meanwhile(ros, bench, states, 'trajectory refused: ')
    assert bench.tracker.running
    assert 'Traceback' not in bench.tracker.output


def test_of_a_flood_of_plans_the_newest_is_followed(ros: Ros, plan: Trajectory) -> None:
    """All of them would take more time than the commands leave; the last must not be lost."""
    bench, states = Bench(ros, 'flooded'), ros.publisher('/flooded/joint_states', JointState)
    followed = ros.subscribe('/flooded/trajectory_in_force', JointTrajectory, LATCHED)
    keep_publishing(ros, states, 0.2)
    for _ in range(150):
        publish_state(states)
        newest = message(plan)
        bench.plans.publish(newest)
        ros.spin_for(0.01)
    assert ros.publish_until(
        lambda: publish_state(states),
        lambda: bool(followed) and followed[-1].header.stamp == newest.header.stamp,
    )
    assert len(followed) < 100
    bench.tracker.end_cleanly()


def test_a_state_that_stops_coming_is_an_error_until_it_returns(
    ros: Ros, bench: Bench, states: Any
) -> None:
    keep_publishing(ros, states, 0.2)
    assert bench.says('state_timeout', level=2)
    assert ros.publish_until(
        lambda: publish_state(states),
        lambda: bench.said('idle') and not bench.said('state_timeout'),
    )


def test_parameters_are_refused_with_a_sentence(ros: Ros, bench: Bench) -> None:
    reasons = ros.set_parameters('/scripted/tracker', weights__torque=-1.0, plant__mass=0.0)
    assert 'weights.torque' in reasons[0]
    assert 'plant.mass' in reasons[1]
    assert ros.set_parameters('/scripted/tracker', weights__torque=3.0) == ['']
    assert 'fixed' in ros.set_parameters('/scripted/tracker', rate=100.0)[0]


@pytest.mark.parametrize('kind', ['crane', '3'])
def test_an_unknown_kind_ends_it_with_one_sentence(ros: Ros, kind: str) -> None:
    process = ros.start('tdm_planner.nodes.tracker', {'kind': kind}, namespace='fatal')
    assert process.process.wait(30.0) == 2
    shown = kind if kind.isdecimal() else repr(kind)
    assert process.output == (
        f"fatal: parameter 'kind' = {shown} is not allowed: must be one of pendulum, robot\n"
    )


def test_it_ends_cleanly(bench: Bench) -> None:
    bench.tracker.end_cleanly()


@pytest.fixture(scope='module')
def rig(ros: Ros) -> Bench:
    """Return a tracker with the simulated pendulum, 5 % wrong and noisy."""
    noise = {'theta': 0.0015, 'psi': 0.0015, 'theta_dot': 0.1, 'psi_dot': 0.1}
    ros.start(
        'tdm_sim.pendulum_plant',
        {
            'limits.torque': LIMIT,
            'mismatch': 0.05,
            **{f'noise.{name}': value for name, value in noise.items()},
        },
        namespace='rig',
    )
    return Bench(ros, 'rig', replan__on_deviation=True, replan__interval=0.2)


def watch(ros: Ros) -> list[JointState]:
    return ros.subscribe('/rig/joint_states', JointState)


def angles(states: list[JointState]) -> np.ndarray:
    return np.array([math.remainder(s.position[0], math.tau) for s in states])


def test_the_pendulum_swings_up_and_is_held(ros: Ros, rig: Bench, plan: Trajectory) -> None:
    measured = watch(ros)
    assert ros.spin_until(lambda: bool(measured))
    assert rig.says('idle', level=0)
    assert ros.spin_until(rig.drives)
    rig.plans.publish(message(plan))
    assert rig.says('waiting')
    assert rig.says('holding', level=0)
    ros.spin_for(1.5)
    first = len(measured)
    ros.spin_for(1.0)
    assert len(measured) - first > 100
    assert np.abs(angles(measured[first:])).max() < 0.06
    assert np.abs([c.effort[0] for c in rig.commands]).max() <= LIMIT
    assert np.abs([e.position[0] for e in rig.errors[-100:]]).max() < 0.06


def test_a_new_plan_is_asked_for_when_it_falls(ros: Ros, rig: Bench, plan: Trajectory) -> None:
    asked: list[float] = []

    def serve(_: Any, response: Any) -> Any:
        asked.append(time.monotonic())
        response.success = False
        response.message = '{"code": "INFEASIBLE", "reason": "test"}'
        return response

    ros.node.create_service(Trigger, '/rig/plan', serve)
    # An answer to a client that was met only just now is lost, and waited for for 10 s.
    assert ros.spin_until(lambda: ros.node.count_clients('/rig/plan') > 0)
    ros.spin_for(1.0)
    assert ros.set_parameter_mapping('/rig/pendulum_plant', {'disturbance.impulse': 0.02}) == ['']
    ros.call('/rig/push', Trigger)
    assert rig.says('recovering', 'tolerance.path', level=2)
    assert ros.spin_until(lambda: len(asked) >= 3, 30.0)
    assert min(np.diff(asked)) > 0.15
    # at rest nothing is commanded, as plans assume
    assert rig.commands[-1].effort[0] == 0.0


def test_after_a_fall_the_next_plan_is_tracked(ros: Ros, rig: Bench, plan: Trajectory) -> None:
    ros.call('/rig/reset', Trigger)
    ros.spin_for(0.1)
    rig.plans.publish(message(plan))
    assert rig.says('holding', level=0)


def test_a_tracker_that_joins_late_takes_over(ros: Ros, rig: Bench, plan: Trajectory) -> None:
    rig.tracker.end_cleanly()
    ros.call('/rig/reset', Trigger)
    rig.plans.publish(message(plan, 6.0))
    rig.tracker = rig.start()
    assert rig.says('waiting')
    assert rig.says('holding', level=0)
    rig.tracker.end_cleanly()

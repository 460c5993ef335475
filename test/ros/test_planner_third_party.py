# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Problems as another package would bring them, and what their solvers can do to the planner."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
import pytest
from ros_harness import MODULES
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from stepped_ros import NodeHere, Stepped
from tdm_planner.direct_method import Budget
from tdm_planner.exceptions import Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import PendulumSwingUp, Problem, Search, Solution, SolverParameters
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import verify
from trajectory_msgs.msg import JointTrajectory

Array = NDArray[np.float64]
STRONG = {'limits.torque': 0.09}


@dataclass(frozen=True)
class FailingSwingUp(PendulumSwingUp):
    """Fails as `failure` says."""

    name: ClassVar[str] = 'failing_swing_up'

    failure: str = parameter(
        'crash', 'how to fail', choices=('crash', 'verification', 'infeasible', 'not')
    )

    def solve(self, *args: Any, **kwargs: Any) -> Solution:
        if self.failure == 'crash':
            raise ZeroDivisionError('a bug\nin the solver')
        if self.failure == 'verification':
            raise VerificationFailed('the replay\nmisses the goal')
        if self.failure == 'infeasible':
            raise Infeasible('the torque is too weak')
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class CartStart(Validated):
    position: float = parameter(1.0, 'position', unit='m')


@dataclass(frozen=True)
class Cart(Problem, Validated):
    """A cart to be pushed to the origin in the shortest time: half the way on, half off."""

    name: ClassVar[str] = 'cart'

    start: CartStart = group(CartStart)
    force: float = parameter(1.0, 'largest force per mass', unit='m/s^2', allowed=POSITIVE)
    solver: SolverParameters = group(SolverParameters)

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> TwoStrokes:
        return TwoStrokes(self, budget)

    def describe(self, plan: Solution) -> str:
        return 'there in two strokes'


class TwoStrokes(Search[float]):
    """The only candidate is known: the time of one stroke."""

    def __init__(self, cart: Cart, budget: Budget) -> None:
        super().__init__(budget)
        self.cart = cart

    def candidates(self) -> list[float]:
        return [float(np.sqrt(abs(self.cart.start.position) / self.cart.force))]

    def plans(self, candidate: float) -> Iterator[Solution]:
        x, half = self.cart.start.position, candidate
        f = -np.sign(x) * self.cart.force
        motion = Trajectory(
            times=np.array([0.0, half, 2 * half]),
            states=np.array([[x, 0.0], [x / 2, f * half], [0.0, 0.0]]),
            controls=np.array([[f], [-f], [-f]]),
            state_names=('position', 'velocity'),
            control_names=('force',),
        )
        check = verify(DoubleIntegrator(), motion, np.zeros(2), np.full(2, 1e-9), ())
        yield Solution({'cart': motion}, check, 2 * half, np.array([half]), 0.0)

    def failure(self) -> Infeasible:
        return Infeasible('the strokes do not end at the origin')


class DoubleIntegrator:
    state_names = ('position', 'velocity')
    state_units = ('m', 'm/s')
    control_names = ('force',)
    control_units = ('m/s^2',)

    def derivative(self, state: Array, control: Array) -> Array:
        return np.stack([state[..., 1], control[..., 0]], axis=-1)


def start(ros: Stepped, name: str, **given: Any) -> NodeHere:
    """Start a planner, which has the name of its namespace, for a problem of this module."""
    parameters = {'start.source': 'parameters', **given}
    return ros.start(MODULES['planner'], parameters, namespace=name)


def test_failures_have_their_codes_and_show_in_the_diagnostics(ros):
    name = '/failing/planner: planning'
    planner = start(ros, 'failing', problem=f'{__name__}:FailingSwingUp', **STRONG)
    expected = {
        'crash': ('INTERNAL', 'ZeroDivisionError: a bug in the solver', b'\x02'),
        'verification': ('VERIFICATION_FAILED', 'the replay misses the goal', b'\x01'),
        'infeasible': ('INFEASIBLE', 'the torque is too weak', b'\x01'),
    }
    for failure, (code, reason, level) in expected.items():
        ros.set_parameters('/failing/planner', failure=failure)
        assert ros.trigger('/failing/plan') == (False, {'code': code, 'reason': reason})
        message = f'{code}: {reason}'
        assert f'no plan: {message}' in planner.output
        assert ros.says(name, message, level=level[0])
    ros.set_parameters('/failing/planner', failure='not')
    assert ros.trigger('/failing/plan')[0]
    assert ros.says(name, 'plan 1 active', level=0)
    status = ros.statuses[name]
    assert status.hardware_id == '/failing/planner'
    figures = {item.key: item.value for item in status.values}
    assert figures['requests'] == '4'
    assert figures['failures'] == '3'
    assert figures['age of joint_states [s]'] == 'never received'
    assert float(figures['duration [s]']) > 0.3
    assert figures['plan age [s]'] == '-1'
    assert float(figures['margin of disk_angle']) > 0
    assert figures['worst margin'].endswith(')')
    assert planner.output.count('Traceback') == 1  # of the one that is a fault of the program
    assert planner.output.count("raise ZeroDivisionError('a bug") == 1
    ros.log.clear()  # or it would be taken for a crash


def test_a_problem_of_another_kind_is_served_by_names(ros):
    start(ros, 'cart', problem=f'{__name__}:Cart', force=4)
    done, answer = ros.trigger('/cart/plan')
    assert done
    assert answer['duration'] == pytest.approx(1.0)
    assert answer['summary'] == 'there in two strokes'
    states = ros.subscribe('/cart/trajectory', JointTrajectory, LATCHED)
    assert ros.meet(lambda: bool(states))
    assert list(states[0].joint_names) == ['position', 'velocity', 'force']
    positions = [list(point.positions[:2]) for point in states[0].points]
    assert positions == [[1, 0], [0.5, -2], [0, 0]]
    assert [point.effort[2] for point in states[0].points] == [-4, 4, 0]  # at last for no time
    assert nanoseconds_of(states[0].points[1].time_from_start) == 500_000_000
    # Measured, it waits for its state.
    ros.set_parameters('/cart/planner', start__source='measured')
    assert ros.trigger('/cart/plan')[1]['code'] == 'NO_STATE'
    pending = ros.request('/cart/plan', Trigger)
    state = JointState(name=['position'], position=[-2.0])
    ros.publisher('/cart/joint_states', JointState).publish(state)
    assert ros.spin_until(pending.done)
    assert pending.result().success, pending.result().message
    ros.settle()
    assert states[-1].points[0].positions[0] == -2.0


def test_a_problem_with_nothing_to_measure_is_planned_from_parameters(ros):
    given = {'problem': 'brachistochrone:Brachistochrone', 'start.source': 'measured'}
    start(ros, 'homing', **given)
    assert ros.trigger('/homing/plan')[0]


def test_without_its_problem_there_is_no_node(ros):
    says = r'such as my_module:MyProblem \(did you mean pendulum_swing_up\?\)'
    with pytest.raises(InvalidProblem, match=says):
        start(ros, 'fatal', problem='pendulum_swingup')

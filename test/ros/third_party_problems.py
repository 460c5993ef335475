# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Problems as another package would bring them.

`test_planner_third_party` registers them, `test_own_plant` draws the last two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import time
from typing import Any, ClassVar

from double_integrator import DoubleIntegrator as StatedCart
import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method import Budget
from tdm_planner.drawing import Box, Disc, Line, Shape
from tdm_planner.exceptions import Infeasible, VerificationFailed
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import (
    PendulumSwingUp,
    Problem,
    Search,
    Solution,
    SolverParameters,
)
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import verify

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SlowSwingUp(PendulumSwingUp):
    """A swing-up that takes `thinking` s longer to find."""

    name: ClassVar[str] = 'slow_swing_up'

    thinking: float = parameter(1.0, 'time to think', unit='s', allowed=POSITIVE)

    def solve(self, *args: Any, **kwargs: Any) -> Solution:
        time.sleep(self.thinking)
        return super().solve(*args, **kwargs)


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


@dataclass(frozen=True)
class HomingCart(Problem, Validated):
    """The same from a place that is no parameter of the start: nothing can be measured."""

    name: ClassVar[str] = 'homing_cart'

    side: str = parameter('right', 'side to start from', choices=('left', 'right'))
    solver: SolverParameters = group(SolverParameters)

    def search(
        self, budget: Budget, rng: np.random.Generator, previous: Solution | None
    ) -> TwoStrokes:
        position = 1.0 if self.side == 'right' else -1.0
        return TwoStrokes(Cart(start=CartStart(position=position)), budget)


@dataclass(frozen=True)
class Rail(StatedCart):
    """A cart with a lamp on a rail."""

    name: ClassVar[str] = 'rail'

    def joints(self) -> Mapping[str, tuple[str, str]]:
        return {'cart': ('x', 'v')}

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        place = x[0]
        return (
            Line(((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 'limit'),
            Box((place, 0.0, 0.1), (0.4, 0.2, 0.2)),
            Disc((place, 0.0, 0.3), 0.1, trail=True),
        )


@dataclass(frozen=True)
class Blurred(Rail):
    """The same with a drawing that fails."""

    name: ClassVar[str] = 'blurred'

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        return (x[7],)

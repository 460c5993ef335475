# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Problems as another package would bring them; `test_planner_third_party` registers them."""

from __future__ import annotations

from dataclasses import dataclass
import time
from typing import Any, ClassVar

import numpy as np

from tdm_planner.exceptions import Infeasible, VerificationFailed
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import PendulumSwingUp, Problem, Solution, SolverParameters
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Verification


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

    def prepare(self) -> None:
        pass

    def solve(
        self,
        deadline: float | None = None,
        seed: int | None = None,
        warm_start: Solution | None = None,
    ) -> Solution:
        x, f = self.start.position, -np.sign(self.start.position) * self.force
        half = float(np.sqrt(abs(x) / self.force))
        plan = Trajectory(
            times=[0.0, half, 2 * half],
            states=[[x, 0.0], [x / 2, f * half], [0.0, 0.0]],
            controls=[[f], [-f], [-f]],
            state_names=('position', 'velocity'),
            control_names=('force',),
        )
        return Solution(
            problem=self.name,
            trajectories={'cart': plan},
            cost=2 * half,
            penalty=0.0,
            parameters=np.array([half]),
            evaluations=1,
            solve_time=0.0,
            verification=Verification(ok=True, terminal_error=np.zeros(2)),
            summary='there in two strokes',
        )

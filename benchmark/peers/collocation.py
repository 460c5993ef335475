# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Hermite-Simpson collocation by CasADi and Ipopt: what the peers' formulations share.

States are piecewise cubic, controls piecewise linear (Hargraves and Paris, "Direct Trajectory
Optimization Using Nonlinear Programming and Collocation", 1987). All derivatives are exact; a
program is built once and solved for any boundary conditions.
"""

from __future__ import annotations

from dataclasses import dataclass
import time
from typing import Any

import casadi
import numpy as np
from tdm_planner.arrays import Array

IPOPT: dict[str, Any] = {
    'print_level': 0,
    'sb': 'yes',
    'max_iter': 1000,
    'linear_solver': 'mumps',
    'mu_strategy': 'adaptive',
}
# An initial guess that is nearly optimal: stay near it, start with a small barrier.
WARM: dict[str, Any] = {
    'mu_strategy': 'monotone',
    'mu_init': 1e-4,
    'warm_start_init_point': 'yes',
    'warm_start_bound_push': 1e-6,
    'warm_start_slack_bound_push': 1e-6,
    'warm_start_bound_frac': 1e-6,
    'warm_start_slack_bound_frac': 1e-6,
    'warm_start_mult_bound_push': 1e-6,
}


@dataclass(frozen=True)
class Outcome:
    """What Ipopt returned: variables, multipliers by argument, processor time [s], iterations."""

    converged: bool
    x: Array
    multipliers: dict[str, Array]
    seconds: float
    iterations: int
    status: str


class Solver:
    """One nonlinear program, its solver from any guess and that from a neighbour's optimum."""

    def __init__(self, program: dict[str, Any], **ipopt: Any) -> None:
        self.variables = int(program['x'].numel())
        self.rows = int(program['g'].numel())
        self._solvers = {
            warm: casadi.nlpsol(
                f'collocation_{"warm" if warm else "cold"}',
                'ipopt',
                program,
                {'print_time': False, 'expand': True, 'ipopt': options | ipopt},
            )
            for warm, options in ((False, IPOPT), (True, IPOPT | WARM))
        }

    def solve(self, guess: Array | Outcome, warm: bool, **arguments: Any) -> Outcome:
        """
        Solve from variables or from an outcome with its multipliers, `warm` if nearly optimal.

        `arguments` are CasADi's: lbx, ubx, lbg, ubg, p.
        """
        if isinstance(guess, Outcome):
            arguments |= {'x0': guess.x, **guess.multipliers}
        else:
            arguments['x0'] = guess
        solver = self._solvers[warm]
        began = time.process_time()
        result = solver(**arguments)
        seconds = time.process_time() - began
        stats = solver.stats()
        return Outcome(
            converged=bool(stats['success']),
            x=np.asarray(result['x']).ravel(),
            multipliers={
                f'{name}0': np.asarray(result[name]).ravel() for name in ('lam_x', 'lam_g')
            },
            seconds=seconds,
            iterations=int(stats['iter_count']),
            status=str(stats['return_status']),
        )


def defects(f: Any, x: Any, u: Any, h: Any) -> tuple[Any, Any]:
    """
    Defects (nx, N) of intervals `h` (1, N), and the states at their middles (nx, N).

    `x` (nx, N+1) and `u` (nu, N+1) are at the ends of the intervals, `f` the equations of motion
    as a function of one state and one control.
    """
    n = int(h.shape[1])
    steps = casadi.repmat(h, int(x.shape[0]), 1)
    rates = f.map(n + 1)(x, u)
    left, right = x[:, :-1], x[:, 1:]
    middle = (left + right) / 2 + steps / 8 * (rates[:, :-1] - rates[:, 1:])
    rates_between = f.map(n)(middle, (u[:, :-1] + u[:, 1:]) / 2)
    slope = rates[:, :-1] + 4 * rates_between + rates[:, 1:]
    return right - left - steps / 6 * slope, middle

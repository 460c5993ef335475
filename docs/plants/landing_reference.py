# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The landing of `landing.py` by full collocation, to compare with: needs casadi.

Hermite-Simpson collocation of all states and controls on equal intervals, limits kept at their
ends and middles, solved by Ipopt from the direct method's plan. Doubling the intervals shows
whether the optimum found is that of the problem or of the grid.

Run it: ``python docs/plants/landing_reference.py``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import casadi
from landing import DRAG, G, INDUCED, Landing, table
import numpy as np
from tdm_planner.problems import DirectSolverParameters
from tdm_planner.trajectory import Trajectory


class Optimum(NamedTuple):
    """Performance index [s], time [s], and the bank angles at the ends of the intervals [rad]."""

    cost: float
    duration: float
    bank: np.ndarray


def collocation(problem: Landing, guess: Trajectory, intervals: int = 40) -> Optimum:
    """Return the optimum by collocation, from a initial guess."""
    opti = casadi.Opti()
    t_f = opti.variable()
    step = t_f / intervals
    grid = np.linspace(0.0, guess.duration, 2 * intervals + 1)  # ends and middles in turn
    sample = guess.sample(grid)
    x, u = opti.variable(6, grid.size), opti.variable(3, grid.size)
    slopes, index = _slopes(x, u), _integrand(problem, u)
    first, middle, last = slice(0, -2, 2), slice(1, None, 2), slice(2, None, 2)
    left, right = slopes[:, first], slopes[:, last]
    opti.subject_to(x[:, middle] == 0.5 * (x[:, first] + x[:, last]) + step / 8.0 * (left - right))
    opti.subject_to(
        x[:, last] - x[:, first] == step / 6.0 * (left + 4.0 * slopes[:, middle] + right)
    )
    for column, end in ((0, problem.start), (grid.size - 1, problem.goal)):
        state = [end.x, end.y, end.h, end.speed, end.path_angle, end.heading]
        opti.subject_to(x[:, column] == state)
    opti.subject_to(opti.bounded(0.0, u[0, :], problem.thrust))
    opti.subject_to(opti.bounded(0.0, u[1, :], problem.load))
    opti.subject_to(opti.bounded(-problem.bank, u[2, :], problem.bank))
    opti.subject_to(u[1, :] <= (x[3, :] / problem.stall) ** 2)
    opti.subject_to(x[2, :] >= 0.0)
    simpson = casadi.sum2(index[:, first] + 4.0 * index[:, middle] + index[:, last])
    cost = t_f + step / 6.0 * simpson
    opti.minimize(cost)
    opti.set_initial(x, sample.state.T)
    opti.set_initial(u, sample.control.T)
    opti.set_initial(t_f, guess.duration)
    opti.solver('ipopt', {'print_time': False}, {'print_level': 0, 'sb': 'yes'})
    found = opti.solve()
    bank = np.asarray(found.value(u))[2, ::2]
    return Optimum(float(found.value(cost)), float(found.value(t_f)), bank)


def _slopes(x: Any, u: Any) -> Any:
    v, gamma, chi = x[3, :], x[4, :], x[5, :]
    thrust, n, bank = u[0, :], u[1, :], u[2, :]
    level = v * casadi.cos(gamma)
    return casadi.vertcat(
        level * casadi.cos(chi),
        level * casadi.sin(chi),
        v * casadi.sin(gamma),
        thrust - DRAG * v**2 - INDUCED * n**2 / v**2 - G * casadi.sin(gamma),
        G / v * (n * casadi.cos(bank) - casadi.cos(gamma)),
        G * n * casadi.sin(bank) / level,
    )


def _integrand(problem: Landing, u: Any) -> Any:
    n, bank = u[1, :], u[2, :]
    return problem.comfort * (n**2 - 2.0 * n * casadi.cos(bank) + 1.0)


def reversals(bank: np.ndarray) -> int:
    """Return how often the bank is thrown to the other side."""
    clear = np.sign(bank[np.abs(bank) > 0.3])
    return int(np.count_nonzero(np.diff(clear)))


if __name__ == '__main__':
    plans = table((2, 3, 6, 9), (0, 2))
    problem = Landing()
    print('intervals    J [s]      t_f [s]')
    for intervals in (20, 40, 80, 160):
        best = collocation(problem, plans[6, 2].trajectory, intervals)
        print(f'{intervals:9d}    {best.cost:.5f}   {best.duration:.3f}')
    print('varied parameters    J [s]      over collocation')
    for plan in sorted(plans.values(), key=lambda plan: plan.parameters.size):
        over = 100.0 * (plan.cost / best.cost - 1.0)
        print(f'{plan.parameters.size:17d}    {plan.cost:.5f}   {over:.2f} %')
    print('time alone, without comfort:')
    hasty = replace(problem, comfort=0.0, solver=DirectSolverParameters(deadline=10.0))
    plan = hasty.solve()
    print(f'{plan.parameters.size} varied parameters: {plan.cost:.3f} s')
    for intervals in (20, 40, 80):
        best = collocation(hasty, plan.trajectory, intervals)
        turns = reversals(best.bank)
        print(f'{intervals} intervals: {best.cost:.3f} s, bank reversed {turns} times')

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The landing of `landing.py` by full collocation, to compare with: needs casadi.

Trapezoidal collocation of all states and controls, solved by Ipopt from the direct method's plan.

Run it: ``python docs/plants/landing_reference.py``.
"""

from __future__ import annotations

import casadi
from landing import DRAG, G, INDUCED, Landing
import numpy as np

from tdm_planner.problems import DirectSolverParameters, Solution


def collocation(problem: Landing, guess: Solution, intervals: int = 80) -> float:
    """Return the minimum time [s] by collocation on equal intervals."""
    motion = guess.trajectory
    sample = motion.sample(np.linspace(0.0, motion.duration, intervals + 1))
    opti = casadi.Opti()
    x, u = opti.variable(6, intervals + 1), opti.variable(3, intervals + 1)
    t_f = opti.variable()
    v, gamma, chi = x[3, :], x[4, :], x[5, :]
    thrust, n, bank = u[0, :], u[1, :], u[2, :]
    level = v * casadi.cos(gamma)
    slopes = casadi.vertcat(
        level * casadi.cos(chi),
        level * casadi.sin(chi),
        v * casadi.sin(gamma),
        thrust - DRAG * v**2 - INDUCED * n**2 / v**2 - G * casadi.sin(gamma),
        G / v * (n * casadi.cos(bank) - casadi.cos(gamma)),
        G * n * casadi.sin(bank) / level,
    )
    step = t_f / intervals
    opti.minimize(t_f)
    opti.subject_to(x[:, 1:] - x[:, :-1] == 0.5 * step * (slopes[:, 1:] + slopes[:, :-1]))
    for column, end in ((0, problem.start), (intervals, problem.goal)):
        state = [end.x, end.y, end.h, end.speed, end.path_angle, end.heading]
        opti.subject_to(x[:, column] == state)
    opti.subject_to(opti.bounded(0.0, thrust, problem.thrust))
    opti.subject_to(opti.bounded(0.0, n, problem.load))
    opti.subject_to(opti.bounded(-problem.bank, bank, problem.bank))
    opti.subject_to(n <= (v / problem.stall) ** 2)
    opti.subject_to(x[2, :] >= 0.0)
    opti.set_initial(x, sample.state.T)
    opti.set_initial(u, sample.control.T)
    opti.set_initial(t_f, motion.duration)
    opti.solver('ipopt', {'print_time': False}, {'print_level': 0, 'sb': 'yes'})
    return float(opti.solve().value(t_f))


if __name__ == '__main__':
    problem = Landing(solver=DirectSolverParameters(deadline=10.0))
    plan = problem.solve()
    best = collocation(problem, plan)
    print(f'direct method, {plan.parameters.size} varied parameters: {plan.cost:.3f} s')
    print(f'collocation: {best:.3f} s; ratio {plan.cost / best:.3f}')

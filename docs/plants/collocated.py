# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The best known optima of the gallery's plants, by collocation: best_known.json.

Hermite-Simpson collocation of all states, controls linear in every interval, limits with their
reserves kept at the intervals' ends and middles, Ipopt. First guesses are straight lines between
the ends with hardly any control, then random bends of them, then what other cases of the plant
came to; the cheapest on 40 intervals go on to 80 and 160. `cost_80` beside `cost` (of 160) shows
what the grid makes. `cold_cpu` is the processor time [s] to the first success on 40 intervals from
the line and up to seven bends, `cold_failures` of them included, but not `cold_build`, that of
tracing and building the program; `cold_cost` is what comes of it.

Run it: ``python docs/plants/collocated.py [MODULE ...]``.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path
import sys
from time import process_time
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from table import cases, GALLERY

HERE = Path(__file__).resolve().parent
STARTS, COLD, KEPT = 16, 8, 5
ROUGH = {'tol': 1e-5, 'constr_viol_tol': 1e-7, 'max_iter': 200}
EXACT = {'tol': 1e-8, 'constr_viol_tol': 1e-9, 'max_iter': 1000}
QUIET = {'print_time': False, 'show_eval_warnings': False}
BUILD = {'expand': True, 'detect_simple_bounds': True}


class Motion(NamedTuple):
    """States (nx, 2n + 1) at ends and middles, controls (nu, n + 1) at ends, duration [s]."""

    x: Any
    u: Any
    t: float
    cost: float = np.inf
    cpu: float = 0.0

    def on(self, n: int) -> Motion:
        """Return it on `n` intervals."""

        def read(rows: Any, count: int) -> Any:
            old, new = np.linspace(0, 1, rows.shape[1]), np.linspace(0, 1, count)
            return np.stack([np.interp(new, old, row) for row in rows])

        return Motion(read(self.x, 2 * n + 1), read(self.u, n + 1), self.t)


def ends(problem: Any) -> Any:
    """Return what the boundary conditions say of the states: (2, nx), NaN where they are free."""
    rng, found = np.random.default_rng(0), []
    for side, where in enumerate(('start', 'end')):
        y = {}
        for name, output in problem.outputs().items():
            y[name] = rng.normal(size=(output.derivatives + 1, 3))
            for order, value in output.conditions(where).items():
                y[name][order] = value
        z = {name: (s.start, s.end)[side] for name, s in problem.integrated().items()}
        z = {name: rng.normal(size=3) if v is None else np.full(3, v) for name, v in z.items()}
        states = np.stack(np.broadcast_arrays(*problem.invert(y, z)[0]))
        found.append(np.where(np.ptp(states, axis=1) < 1e-9, states[:, 0], np.nan))
    return np.array(found)


def line(problem: Any, n: int, bend: float, rng: np.random.Generator) -> Motion:
    """Return straight lines between the ends, with random waves of size `bend`."""
    (first, last), given = np.nan_to_num(ends(problem)), problem.duration()
    s = np.linspace(0, 1, 2 * n + 1)
    x = first[:, None] + (last - first)[:, None] * s
    u = np.full((len(problem.control_names), n + 1), 1e-3)
    for k in (1, 2, 3):
        size = bend * (np.abs(last - first) + 0.3)[:, None] / k
        x += size * rng.normal(size=(len(x), 1)) * np.sin(k * np.pi * s)
        u += bend * rng.normal(size=(len(u), 1)) * np.cos(k * np.pi * s[::2])
    return Motion(x, u, given.guess * np.exp((not given.fixed) * 0.6 * bend * rng.normal()))


class Program:
    """The nonlinear program of a problem on `n` intervals; `smooth` is charged for chatter."""

    def __init__(self, problem: Any, n: int, options: dict[str, float], smooth: float) -> None:
        """Trace the problem, one node, and lay the intervals out."""
        opti, count, guess = ca.Opti(), 2 * n + 1, line(problem, n, 0.0, np.random.default_rng())
        nx, nu, allowed = len(guess.x), len(guess.u), problem.duration()
        limits: Any = getattr(problem, 'control_limits', dict)()
        bounds = np.array([limits.get(k, (-np.inf, np.inf)) for k in problem.control_names])
        largest = np.abs(bounds).max(axis=1, keepdims=True)
        su, st = np.where(np.isfinite(largest), largest, 1.0), allowed.guess
        self.scales = np.maximum(np.abs(guess.x).max(1), 1e-2)[:, None], su, st
        self.free = opti.variable(nx, count), opti.variable(nu, n + 1), opti.variable()
        x, u, t = (v * s for v, s in zip(self.free, self.scales, strict=True))
        node = [ca.SX.sym('t'), ca.SX.sym('x', nx), ca.SX.sym('u', nu)]
        at = node[0], ca.vertsplit(node[1]), ca.vertsplit(node[2])
        left = [v - problem.reserve.get(name, 0.0) for name, v in problem.margins(*at).items()]
        margins = ca.vertcat(ca.SX(0, 1), *left)
        stated = [ca.vertcat(*problem.derivative(*at[1:])), margins, problem.running_cost(*at)]
        every = ca.Function('every', node, [ca.SX(v) for v in stated]).map(count)
        pairs = ca.reshape(ca.vertcat(u[:, :-1], (u[:, :-1] + u[:, 1:]) / 2), nu, 2 * n)
        f, g, q = every(t * np.linspace(0, 1, count)[None], x, ca.horzcat(pairs, u[:, -1]))
        (a, m, b), (fa, fm, fb), (qa, qm, qb) = (
            (v[:, :-1:2], v[:, 1::2], v[:, 2::2]) for v in (x, f, q)
        )
        h, last, by = t / n, ca.vertsplit(x[:, -1]), ca.repmat(1 / self.scales[0], 1, n)
        vanish = [
            (b - a - h / 6 * (fa + 4 * fm + fb)) * by,
            (m - (a + b) / 2 - h / 8 * (fa - fb)) * by,
        ]
        for value in [*map(ca.vec, vanish), *problem.end_conditions(t, last)]:
            opti.subject_to(value == 0)
        if margins.numel():
            opti.subject_to(ca.vec(g) >= 0)
        for row, (low, high) in enumerate(bounds / su):
            if np.isfinite(largest[row]):
                opti.subject_to(opti.bounded(low, self.free[1][row, :], high))
        for column, pins in zip((0, count - 1), ends(problem), strict=True):
            for row in np.flatnonzero(np.isfinite(pins)).tolist():
                opti.subject_to(self.free[0][row, column] == pins[row] / self.scales[0][row, 0])
        shortest, longest = (st, st) if allowed.fixed else allowed.bounds
        opti.subject_to(opti.bounded(shortest / st, self.free[2], longest / st))
        self.cost = problem.final_cost(t, last) + h / 6 * ca.sum2(qa + 4 * qm + qb)
        self.opti, self.smooth, self.charge = opti, smooth, opti.parameter()
        opti.minimize(self.cost + self.charge * ca.sumsqr(ca.diff(self.free[1], 1, 1)))
        opti.solver('ipopt', QUIET | BUILD, {'print_level': 0, 'sb': 'yes', **options})

    def solve(self, guess: Motion) -> Motion:
        """Return what Ipopt finds from this guess, its cost infinite if it fails."""
        for free, value, scale in zip(self.free, guess[:3], self.scales, strict=True):
            self.opti.set_initial(free, value / scale)
        size = abs(float(self.opti.value(self.cost, self.opti.initial())))
        self.opti.set_value(self.charge, self.smooth * (size if 1e-9 < size < 1e9 else 1.0))
        began = process_time()
        try:
            value = self.opti.solve().value
        except RuntimeError:
            return guess._replace(cost=np.inf, cpu=process_time() - began)
        cpu, cost = process_time() - began, float(value(self.cost))
        x, u, t = (value(v) * s for v, s in zip(self.free, self.scales, strict=True))
        return Motion(np.reshape(x, guess.x.shape), np.reshape(u, guess.u.shape), t, cost, cpu)


def collocate(cls: Any, variations: Any) -> dict[str, dict[str, Any]]:
    """Return the figures of all cases of a class."""
    problems = {case: cls.from_parameters(given) for case, given in cases(variations).items()}
    figures: dict[str, dict[str, Any]] = {}
    found: dict[str, list[Motion]] = {}
    programs: dict[str, Program] = {}
    for case, problem in problems.items():
        rng, began = np.random.default_rng(0), process_time()
        solve = programs.setdefault(case, Program(problem, 40, ROUGH, 1e-4)).solve
        solve(line(problem, 40, 0.0, rng))  # Ipopt's part is built on the way
        build = process_time() - began
        tries = [solve(line(problem, 40, 0.5 * (i > 0), rng)) for i in range(STARTS)]
        cold = [*(i for i, one in enumerate(tries[:COLD]) if one.cost < np.inf), COLD][0]
        figures[case] = {
            'cold_build': round(build - tries[0].cpu, 4),
            'cold_cpu': round(sum(one.cpu for one in tries[:COLD][: cold + 1]), 4),
            'cold_failures': cold,
            'cold_cost': tries[:COLD][cold].cost if cold < COLD else None,
        }
        found[case] = tries
    passed = [min(tries, key=lambda one: one.cost) for tries in found.values()]
    for case, problem in problems.items():
        best = found[case] + [programs[case].solve(one) for one in passed]
        for n in (80, 160):
            program = Program(problem, n, EXACT, 1e-6)
            best = [one for one in sorted(best, key=lambda one: one.cost) if one.cost < np.inf]
            best = [program.solve(one.on(n)) for one in best[:KEPT]]
            figures[case]['cost' if n == 160 else 'cost_80'] = min(one.cost for one in best)
        print(cls.__name__, case, figures[case], flush=True)
    return figures


if __name__ == '__main__':
    ca.GlobalOptions.setNumpyMode(-1)
    path = HERE / 'best_known.json'
    known = json.loads(path.read_text()) if path.exists() else {}
    for module in sys.argv[1:] or GALLERY:
        name, page = GALLERY[module], importlib.import_module(module)
        known[name] = collocate(getattr(page, name), page.VARIATIONS)
        path.write_text(json.dumps(known, indent=2, sort_keys=True) + '\n')

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.


"""
The best known optima of the plants in docs/plants, by collocation: docs/plants/best_known.json.

Hermite-Simpson collocation of all states, controls linear in every interval, limits kept at the
intervals' ends and middles, solved by Ipopt. First guesses are straight lines between the ends
without control, then random bends of them; the cheapest solutions on 40 intervals go on to 80 and
160, from where they are passed on as first guesses to the plant's other cases, too.
`cold_cpu` is the processor time [s] that Ipopt took on 40 intervals to its first success from
straight lines and then bends, failures (`cold_failures`) included.

Run it: ``python tools/collocate_plants.py [MODULE:CLASS ...]``.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path
import sys
import time
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
PLANTS = ROOT / 'docs' / 'plants'
GALLERY = {
    'acrobot': 'Acrobot',
    'auv': 'Auv',
    'ball_and_beam': 'BallAndBeam',
    'bryson_denham': 'BrysonDenham',
    'crane': 'Crane',
    'goddard_rocket': 'GoddardRocket',
    'moon_lander': 'MoonLander',
    'overtaking': 'Overtaking',
    'quadrotor': 'Quadrotor',
    'satellite': 'Satellite',
}
STARTS, KEPT, MESHES = 12, 3, (40, 80, 160)
OPTIONS = {'print_level': 0, 'sb': 'yes', 'max_iter': 500, 'constr_viol_tol': 1e-8}

Array = NDArray[np.float64]


class Guess(NamedTuple):
    """States (nx, 2n + 1) at ends and middles, controls (nu, n + 1) at ends, duration [s]."""

    x: Array
    u: Array
    t: float

    def on(self, n: int) -> Guess:
        """Return it on `n` intervals."""
        x, u = (
            np.stack([np.interp(np.linspace(0, 1, k), np.linspace(0, 1, row.size), row) for row in a])
            for a, k in ((self.x, 2 * n + 1), (self.u, n + 1))
        )
        return Guess(x, u, self.t)


class Found(NamedTuple):
    """A solution of the program."""

    cost: float
    guess: Guess
    ok: bool
    cpu: float


def ends(problem: Any) -> Array:
    """Return what the boundary conditions say of the states: (2, nx), NaN where they are free."""
    rng, found = np.random.default_rng(0), []
    for side, where in enumerate(('start', 'end')):
        fill = rng.normal
        y = {
            name: [
                np.full(3, output.conditions(where).get(k, np.nan)) for k in range(output.derivatives + 1)
            ]
            for name, output in problem.outputs().items()
        }
        y = {name: [np.where(np.isnan(v), fill(size=3), v) for v in values] for name, values in y.items()}
        given = {name: (s.start, s.end)[side] for name, s in problem.integrated().items()}
        z = {name: fill(size=3) if v is None else np.full(3, v) for name, v in given.items()}
        states = np.stack(np.broadcast_arrays(*problem.invert(y, z)[0]))
        found.append(np.where(np.ptp(states, axis=1) < 1e-9, states[:, 0], np.nan))
    return np.array(found)


def straight(problem: Any, n: int, bend: float, rng: np.random.Generator) -> Guess:
    """Return straight lines between the ends, with random waves of size `bend`."""
    first, last = np.nan_to_num(ends(problem))
    s, t = np.linspace(0, 1, 2 * n + 1), problem.duration().guess
    x = first[:, None] + (last - first)[:, None] * s
    u = np.full((len(problem.control_names), n + 1), 1e-3)
    for k in (1, 2, 3) if bend else ():
        size = bend * (np.abs(last - first) + 0.3)[:, None] / k
        x += size * rng.normal(size=(len(x), 1)) * np.sin(k * np.pi * s)
        u += bend * rng.normal(size=(len(u), 1)) * np.cos(k * np.pi * s[::2])
    return Guess(x, u, t if problem.duration().fixed or not bend else t * np.exp(0.3 * rng.normal()))


class Program:
    """The nonlinear program of a problem on `n` intervals."""

    def __init__(self, problem: Any, n: int, tolerance: float, smooth: float) -> None:
        """Trace the problem, one node, and lay the intervals out."""
        self.problem, self.n, nx, nu = problem, n, len(problem.state_names), len(problem.control_names)
        t, x, u = ca.SX.sym('t'), ca.SX.sym('x', nx), ca.SX.sym('u', nu)
        xs, us = ca.vertsplit(x), ca.vertsplit(u)
        f = ca.Function('f', [x, u], [ca.vertcat(*problem.derivative(xs, us))])
        g = ca.Function('g', [t, x, u], [ca.vertcat(*problem.margins(t, xs, us).values())])
        q = ca.Function('q', [t, x, u], [ca.SX(problem.running_cost(t, xs, us))])
        X, U, T = ca.MX.sym('X', nx, 2 * n + 1), ca.MX.sym('U', nu, n + 1), ca.MX.sym('T')
        sx, su, st = ca.MX.sym('sx', nx), ca.MX.sym('su', nu), ca.MX.sym('st')
        xa, ua, duration = X * ca.repmat(sx, 1, 2 * n + 1), U * ca.repmat(su, 1, n + 1), T * st
        um = (ua[:, 1:] + ua[:, :-1]) / 2
        both = ca.horzcat(ca.reshape(ca.vertcat(ua[:, :-1], um), nu, 2 * n), ua[:, -1])
        count, h = 2 * n + 1, duration / n
        times = duration * np.linspace(0, 1, count)[None]
        F, G, Q = f.map(count)(xa, both), g.map(count)(times, xa, both), q.map(count)(times, xa, both)
        a, m, b = xa[:, :-1:2], xa[:, 1::2], xa[:, 2::2]
        fa, fm, fb = F[:, :-1:2], F[:, 1::2], F[:, 2::2]
        by = ca.repmat(1 / sx, 1, n)
        defects = (b - a - h / 6 * (fa + 4 * fm + fb)) * by, (m - (a + b) / 2 - h / 8 * (fa - fb)) * by
        cost = problem.final_cost(duration, ca.vertsplit(xa[:, -1]))
        cost += h / 6 * ca.sum2(Q[:, :-1:2] + 4 * Q[:, 1::2] + Q[:, 2::2])
        end = ca.vertcat(ca.MX(0, 1), *problem.end_conditions(duration, ca.vertsplit(xa[:, -1])))
        self.z, p = ca.vertcat(ca.vec(X), ca.vec(U), T), ca.vertcat(sx, su, st)
        self.cost = ca.Function('J', [self.z, p], [cost])
        rows = ca.vertcat(*map(ca.vec, defects), end, ca.vec(G))
        self.upper = np.r_[np.zeros(2 * n * nx + end.numel()), np.full(G.numel(), np.inf)]
        chatter = ca.MX.sym('c')
        nlp = {'x': self.z, 'f': cost + chatter * ca.sumsqr(U[:, 1:] - U[:, :-1]), 'g': rows}
        self.smooth, options = smooth, {**OPTIONS, 'tol': tolerance}
        self.solver = ca.nlpsol(
            's', 'ipopt', {**nlp, 'p': ca.vertcat(p, chatter)}, {'expand': True, 'print_time': 0, 'ipopt': options}
        )

    def solve(self, guess: Guess) -> Found:
        """Return what Ipopt finds from this guess."""
        low, high = np.array(list(self._limits()), dtype=float).T
        sx, su = (np.maximum(np.abs(v).max(1), 1e-2) for v in (guess.x, guess.u))
        su = np.where(np.isfinite(high), np.maximum(np.abs(low), np.abs(high)), np.maximum(su, 1.0))
        scale, bounds = np.r_[sx, su, guess.t], []
        pins, (shortest, longest) = ends(self.problem), self.problem.duration().bounds
        if self.problem.duration().fixed:
            shortest = longest = guess.t
        for free, u, t in ((-np.inf, low, shortest), (np.inf, high, longest)):
            x = np.full(guess.x.shape, free)
            for column, pin in ((0, pins[0]), (-1, pins[1])):
                x[:, column] = np.where(np.isnan(pin), free, pin)
            bounds.append(np.r_[(x.T / sx).ravel(), np.tile(u / su, self.n + 1), t / guess.t])
        z = np.clip(np.r_[(guess.x.T / sx).ravel(), (guess.u.T / su).ravel(), 1.0], *bounds)
        size = abs(float(self.cost(z, scale)))
        p = np.r_[scale, self.smooth * (size if 1e-9 < size < 1e9 else 1.0)]
        began = time.process_time()
        r = self.solver(x0=z, p=p, lbx=bounds[0], ubx=bounds[1], lbg=0.0, ubg=self.upper)
        cpu, v = time.process_time() - began, np.array(r['x']).ravel()
        x, u = (part.reshape(-1, s.size).T * s[:, None] for part, s in ((v[: guess.x.size], sx), (v[guess.x.size : -1], su)))
        again = Guess(x, u, float(v[-1] * guess.t))
        return Found(float(self.cost(v, scale)), again, self.solver.stats()['success'], cpu)

    def _limits(self) -> Any:
        limits = getattr(self.problem, 'control_limits', dict)()
        return (limits.get(name, (-np.inf, np.inf)) for name in self.problem.control_names)


def collocate(cls: type, variations: Any) -> dict[str, dict[str, Any]]:
    """Return cost, processor time and failures of all cases of a class."""
    cases = {'default': {}, **{str(i): given for i, given in enumerate(variations)}}
    found: dict[str, list[Found]] = {}
    figures: dict[str, dict[str, Any]] = {}
    problems = {case: cls.from_parameters(given) for case, given in cases.items()}
    for case, problem in problems.items():
        rng, program = np.random.default_rng(0), Program(problem, 40, 1e-6, 1e-4)
        tries = [program.solve(straight(problem, 40, 0.5 * (i > 0), rng)) for i in range(STARTS)]
        first = next((i for i, one in enumerate(tries) if one.ok), len(tries))
        spent = sum(one.cpu for one in tries[: first + 1])
        figures[case] = {'cold_cpu': round(spent, 4), 'cold_failures': first}
        found[case] = [one for one in tries if one.ok]
    for case, problem in problems.items():
        passed = [min(other, key=lambda one: one.cost) for other in found.values() if other]
        program = Program(problem, 40, 1e-6, 1e-4)
        more = [program.solve(one.guess.on(40)) for one in passed]
        best = sorted((one for one in [*found[case], *more] if one.ok), key=lambda one: one.cost)
        for n in MESHES[1:]:
            program = Program(problem, n, 1e-8, 1e-6)
            again = [program.solve(one.guess.on(n)) for one in best[:KEPT]]
            best = sorted((one for one in again if one.ok), key=lambda one: one.cost)
            figures[case][f'cost_{n}'] = best[0].cost
        figures[case]['cost'] = best[0].cost
        print(cls.__name__, case, figures[case], flush=True)
    return figures


if __name__ == '__main__':
    ca.GlobalOptions.setNumpyMode(-1)
    sys.path.insert(0, str(PLANTS))
    path = PLANTS / 'best_known.json'
    known = json.loads(path.read_text()) if path.exists() else {}
    for module in sys.argv[1:] or GALLERY:
        page = importlib.import_module(module)
        known[GALLERY[module]] = collocate(getattr(page, GALLERY[module]), page.VARIATIONS)
        path.write_text(json.dumps(known, indent=2, sort_keys=True) + '\n')

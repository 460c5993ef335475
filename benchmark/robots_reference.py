# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Reference costs J_ref of the random crossings: full collocation with CasADi and Ipopt.

Run ``python -m benchmark.robots_reference --scenarios 100`` to write data/robots_reference.json.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

from benchmark.scenarios import ARRIVAL_INTERVAL, Crossing, crossing, MINIMUM_SEPARATION, SLOW_RIG
import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DATA = Path(__file__).parent / 'data' / 'robots_reference.json'
FIRST_CELLS, LATER_CELLS = 44, 6
ACCELERATION = SLOW_RIG['limits.thrust'] / SLOW_RIG['plant.mass']
ANGULAR_ACCELERATION = SLOW_RIG['limits.torque'] / SLOW_RIG['plant.inertia']
RATE = SLOW_RIG['limits.thruster_rate']
WEIGHTS = (SLOW_RIG['weights.time'], SLOW_RIG['weights.sequence'], SLOW_RIG['weights.gas'])


def runge_kutta_map() -> Any:
    """One RK4 step of (17) with held controls (F, delta, T), states x y u v yaw omega alpha."""
    x, u, h = casadi.SX.sym('x', 7), casadi.SX.sym('u', 3), casadi.SX.sym('h')

    def rate(s: Any) -> Any:
        heading = s[4] + s[6]
        thrust = u[0]
        return casadi.vertcat(
            s[2],
            s[3],
            thrust * casadi.cos(heading),
            thrust * casadi.sin(heading),
            s[5],
            u[2],
            u[1],
        )

    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    k4 = rate(x + h * k3)
    return casadi.Function('step', [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


def guess(
    scenario: Crossing, bows: tuple[float, ...], first: float
) -> tuple[list[Array], list[Array], Array]:
    """Quintic motions bowed sideways: states (7, M + 1) and controls (3, M) of every robot."""
    n = len(scenario.start)
    cells = [FIRST_CELLS + LATER_CELLS * i for i in range(n)]
    steps = np.concatenate(
        [np.full(FIRST_CELLS, first / FIRST_CELLS)]
        + [np.full(LATER_CELLS, ARRIVAL_INTERVAL / LATER_CELLS)] * (n - 1)
    )
    times = np.concatenate([[0.0], np.cumsum(steps)])
    states, controls = [], []
    turn = np.angle(np.exp(1j * (scenario.anchor[2] - scenario.start_yaw)))
    for i in range(n):
        t = times[: cells[i] + 1]
        end = t[-1]
        s = np.polynomial.Polynomial([0.0, 1.0 / end])
        share = 10 * s**3 - 15 * s**4 + 6 * s**5
        way = scenario.goal[i] - scenario.start[i]
        side = bows[i] * np.array([-way[1], way[0]])
        bow = 16 * s**2 * (1 - s) ** 2
        path = [scenario.start[i, k] + share * way[k] + bow * side[k] for k in range(2)]
        yaw = scenario.start_yaw[i] + share * turn[i]
        heading = np.unwrap(np.arctan2(path[1].deriv(2)(t), path[0].deriv(2)(t)))
        force = np.hypot(path[0].deriv(2)(t), path[1].deriv(2)(t))
        alpha = heading - yaw(t)
        states.append(
            np.stack(
                [
                    path[0](t),
                    path[1](t),
                    path[0].deriv()(t),
                    path[1].deriv()(t),
                    yaw(t),
                    yaw.deriv()(t),
                    alpha,
                ]
            )
        )
        controls.append(
            np.stack(
                [
                    np.minimum(force[:-1], ACCELERATION),
                    np.clip(np.diff(alpha) / np.diff(t), -RATE, RATE),
                    yaw.deriv(2)(t[:-1]),
                ]
            )
        )
    return states, controls, times


def collocate(scenario: Crossing, bows: tuple[float, ...], first: float = 33.0) -> float | None:
    """Cost of one local solution, None when Ipopt does not converge."""
    n = len(scenario.start)
    problem = casadi.Opti()
    phases = problem.variable(n)
    step = runge_kutta_map()
    states, controls, _ = guess(scenario, bows, first)
    cells = [FIRST_CELLS] + [LATER_CELLS] * (n - 1)
    lengths = casadi.hcat([phases[k] / c for k, c in enumerate(cells) for _ in range(c)])
    radius = MINIMUM_SEPARATION / 2
    turn = np.angle(np.exp(1j * (scenario.anchor[2] - scenario.start_yaw)))
    gas: Any = 0
    xs = []
    for i in range(n):
        last = sum(cells[: i + 1])
        x, u = problem.variable(7, last + 1), problem.variable(3, last)
        h = lengths[:last]
        problem.subject_to(casadi.vec(x[:, 1:] - step.map(last)(x[:, :-1], u, h)) == 0)
        problem.subject_to(problem.bounded(0, u[0, :], ACCELERATION))
        problem.subject_to(problem.bounded(-RATE, u[1, :], RATE))
        problem.subject_to(problem.bounded(-ANGULAR_ACCELERATION, u[2, :], ANGULAR_ACCELERATION))
        for k in range(2):
            problem.subject_to(problem.bounded(radius, x[k, 1:-1], scenario.side - radius))
        problem.subject_to(x[:6, 0] == [*scenario.start[i], 0, 0, scenario.start_yaw[i], 0])
        problem.subject_to(
            x[:6, last] == [*scenario.goal[i], 0, 0, scenario.start_yaw[i] + turn[i], 0]
        )
        gas += casadi.sum2(u[0, :] * h)
        problem.set_initial(x, states[i])
        problem.set_initial(u, controls[i])
        xs.append(x)
    for i, j in itertools.combinations(range(n), 2):
        parked = xs[j].shape[1] - xs[i].shape[1]
        first_robot = casadi.horzcat(
            xs[i][:2, 1:], casadi.repmat(casadi.DM(scenario.goal[i]), 1, parked)
        )
        apart = first_robot - xs[j][:2, 1:]
        problem.subject_to(casadi.sum1(apart[:, :-1] ** 2) >= MINIMUM_SEPARATION**2)
    late = problem.variable(max(n - 1, 1))
    problem.subject_to(problem.bounded(5, phases[0], 120))
    problem.set_initial(phases[0], first)
    for k in range(1, n):
        problem.subject_to(phases[k] >= 0.1)
        problem.subject_to(late[k - 1] >= phases[k] - ARRIVAL_INTERVAL)
        problem.subject_to(late[k - 1] >= ARRIVAL_INTERVAL - phases[k])
        problem.set_initial(phases[k], ARRIVAL_INTERVAL)
    if n == 1:
        problem.subject_to(late[0] == 0)
    cost = WEIGHTS[0] * phases[0] + WEIGHTS[1] * casadi.sum1(late) + WEIGHTS[2] * gas
    problem.minimize(cost)
    problem.solver(
        'ipopt',
        {'print_time': 0},
        {
            'print_level': 0,
            'sb': 'yes',
            'max_iter': 1000,
            'tol': 1e-6,
            'acceptable_tol': 1e-5,
            'mu_strategy': 'adaptive',
        },
    )
    try:
        return float(problem.solve().value(cost))
    except RuntimeError:
        return None


def reference(seed: int, n: int = 3) -> float | None:
    """Best cost of three local solutions: both roundabouts and alternating sides."""
    scenario = crossing(seed, n)
    patterns = [tuple([0.15] * n), tuple([-0.15] * n), tuple(0.15 * (-1) ** i for i in range(n))]
    costs = [collocate(scenario, bows) for bows in patterns]
    found = [cost for cost in costs if cost is not None]
    return min(found) if found else None


def main() -> None:
    """Write the references of the first scenarios."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument('--scenarios', type=int, default=100)
    count = arguments.parse_args().scenarios
    known: dict[str, float | None] = {}
    for seed in range(count):
        known[str(seed)] = reference(seed)
        print(seed, known[str(seed)], flush=True)
        DATA.parent.mkdir(exist_ok=True)
        DATA.write_text(json.dumps({'robots': 3, 'costs': known}, indent=1) + '\n')


if __name__ == '__main__':
    main()

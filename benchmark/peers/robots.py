# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The benchmark's crossings: by Hermite-Simpson collocation (CasADi, Ipopt), by this package.

    python -m benchmark.peers.robots [--scenarios 100]

writes the costs that plans are compared with to data/robots_reference.json.

Every robot has all its states and controls at the nodes of common intervals: the time until the
first arrival is one phase, each further arrival ends another. Separations are kept at nodes and
middles by all pairs until the last robot has arrived.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
import itertools
import json
import time
from typing import Any, NamedTuple

from benchmark.peers.attempts import best_of, Cases
from benchmark.peers.collocation import defects, Outcome, Solver
from benchmark.robots import DATA, MARGIN
from benchmark.scenarios import crossing
import casadi
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.robot_replay import replay
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import (
    gas_used,
    goal_state,
    robot_constraints,
    separation_constraints,
)
from tdm_planner.trajectory import ReplayedMotion, to_nanoseconds, Trajectory
from tdm_planner.verification import check, Constraint, even_times, verify

INTERVALS = 30, 4  # to the first arrival, between two arrivals
BOWS = {'straight ways': 0.0, 'roundabout': 0.15, 'other roundabout': -0.15}
# m, m/s, rad, rad/s; the thruster's angle is free.
TOLERANCE = np.array([0.02, 0.02, 0.01, 0.01, 0.05, 0.02, np.inf])
DISTANCE_SLACK = 0.01  # m
_RESOLUTION = 0.02  # s
_NEAR = 0.05  # m: how far the starts of a neighbouring crossing are, along either axis
TIME_UNIT = 10.0  # s, unit of time
STATE_UNITS = np.array([1.0, 1.0, 1.0 / TIME_UNIT, 1.0 / TIME_UNIT, 1.0, 1.0 / TIME_UNIT, 1.0])
_LONGEST = 120.0
_SHORTEST_PHASE = 0.05
_FIRST = 33.0  # s, the first arrival of an initial guess


class FormationGuess(NamedTuple):
    """Arrival times (n,) s, then states (M, 7) and controls (M, 3) of every robot's nodes."""

    arrivals: Array
    states: list[Array]
    controls: list[Array]


def dynamics(plant: FloatingRobot, limits: Array) -> Any:
    """Equations (17) with time in 10 s and controls (3,) in units of their limits."""
    x, u = casadi.SX.sym('x', 7), casadi.SX.sym('u', 3)
    state, control = x * STATE_UNITS, u * limits
    heading, push = state[4] + state[6], control[0] / plant.mass
    rates = casadi.vertcat(
        state[2],
        state[3],
        push * casadi.cos(heading),
        push * casadi.sin(heading),
        state[5],
        control[2] / plant.inertia,
        control[1],
    )
    return casadi.Function('f', [x, u], [rates * TIME_UNIT / STATE_UNITS])


class FormationCollocation:
    """
    Manoeuvres of n robots with the limits, arena and weights of `task`.

    `first` intervals lead to the first arrival and `later` to each further one. Variables: the
    phases' durations, what the sequence is off by, states and controls of every robot's nodes.
    """

    def __init__(self, task: FormationTask, first: int, later: int, **ipopt: Any) -> None:
        began = time.process_time()
        self.task, n = task, task.n
        self.cells = np.array([first] + [later] * (n - 1))
        self.limits = np.array(
            [task.thrust * task.plant.mass, task.thruster_rate, task.torque * task.plant.inertia]
        )
        self.nodes = np.cumsum(self.cells) + 1
        phases, off = casadi.MX.sym('phases', n), casadi.MX.sym('off', n)
        goals = casadi.MX.sym('goals', 2, n)
        x = [casadi.MX.sym(f'x{i}', 7, m) for i, m in enumerate(self.nodes)]
        u = [casadi.MX.sym(f'u{i}', 3, m) for i, m in enumerate(self.nodes)]
        lengths = casadi.horzcat(
            *(casadi.repmat(phases[k] / c, 1, int(c)) for k, c in enumerate(self.cells))
        )
        f = dynamics(task.plant, self.limits)
        equal, places, gas = [], [], 0
        for i in range(n):
            h = lengths[:, : int(self.nodes[i]) - 1]
            rows, middle = defects(f, x[i], u[i], h)
            equal.append(casadi.vec(rows))
            parked = int(self.nodes[-1] - self.nodes[i])
            stay = casadi.repmat(goals[:, i], 1, parked)
            # Nodes, then middles, all until the last arrival.
            places.append(casadi.horzcat(x[i][:2, 1:], stay, middle[:2, :], stay))
            gas += casadi.sum2((u[i][0, :-1] + u[i][0, 1:]) / 2 * h) * TIME_UNIT * task.thrust
        apart = [
            casadi.sum1((places[i] - places[j]) ** 2).T / task.separation**2
            for i, j in itertools.combinations(range(n), 2)
        ]
        gaps = phases[1:] - task.interval / TIME_UNIT
        unequal = [*apart, off[1:] - gaps, off[1:] + gaps]
        weights = task.weights
        cost = weights[0] * phases[0] * TIME_UNIT + weights[2] * gas
        cost += weights[1] * casadi.sum1(off[1:]) * TIME_UNIT
        program = {
            'x': casadi.veccat(phases, off, *itertools.chain(*zip(x, u, strict=True))),
            'f': cost,
            'g': casadi.veccat(*equal, *unequal),
            'p': casadi.vec(goals),
        }
        self._equal = sum(int(row.numel()) for row in equal)
        self._apart = sum(int(row.numel()) for row in apart)
        self.solver = Solver(program, **ipopt)
        self.build_seconds = time.process_time() - began

    def solve(
        self, task: FormationTask, guess: FormationGuess | Outcome, warm: bool = False
    ) -> Outcome:
        """Solve for starts and goals of `task`, from a guess or a neighbouring outcome."""
        n = task.n
        half = task.separation / 2
        lower = [np.full(n, _SHORTEST_PHASE / TIME_UNIT), np.zeros(n)]
        upper = [np.full(n, _LONGEST / TIME_UNIT), np.full(n, np.inf)]
        lower[0][0] = 5.0 / TIME_UNIT
        for i, m in enumerate(self.nodes):
            high = np.full((m, 7), np.inf)
            high[:, :2] = task.sides - half
            low = -high
            low[:, :2] = half
            start = [*task.start[i], *task.velocity[i], task.yaw[i], task.yaw_rate[i]]
            low[0, :6] = high[0, :6] = start / STATE_UNITS[:6]
            low[-1, :6] = high[-1, :6] = [*task.goal[i], 0.0, 0.0, task.goal_yaw[i], 0.0]
            if np.isfinite(task.alpha[i]):
                low[0, 6] = high[0, 6] = task.alpha[i]
            controls = np.ones((m, 3))
            lower += [low.ravel(), (controls * [0.0, -1.0, -1.0]).ravel()]
            upper += [high.ravel(), controls.ravel()]
        left = self.solver.rows - self._equal - self._apart
        return self.solver.solve(
            guess if isinstance(guess, Outcome) else self.variables(guess),
            warm,
            lbx=np.concatenate(lower),
            ubx=np.concatenate(upper),
            lbg=np.repeat([0.0, 1.0, 0.0], [self._equal, self._apart, left]),
            ubg=np.repeat([0.0, np.inf], [self._equal, self._apart + left]),
            p=task.goal.ravel(),
        )

    def instants(self, arrivals: Array, robot: int) -> Array:
        """Instants of a robot's nodes [s]."""
        edges = np.concatenate([[0.0], arrivals])[: robot + 2]
        parts = [
            np.linspace(edges[k], edges[k + 1], self.cells[k] + 1)[1:] for k in range(robot + 1)
        ]
        return np.concatenate([[0.0], *parts])

    def variables(self, guess: FormationGuess) -> Array:
        """Variables of the program at a guess."""
        phases = np.maximum(np.diff(guess.arrivals, prepend=0.0), _SHORTEST_PHASE)
        off = np.abs(phases - self.task.interval)
        parts = [phases / TIME_UNIT, off / TIME_UNIT]
        for states, controls in zip(guess.states, guess.controls, strict=True):
            parts += [(states / STATE_UNITS).ravel(), (controls / self.limits).ravel()]
        return np.concatenate(parts)

    def motions(self, task: FormationTask, outcome: Outcome) -> dict[str, Trajectory]:
        """Return the motions found, with controls linear between their nodes."""
        n = task.n
        arrivals = np.cumsum(outcome.x[:n]) * TIME_UNIT
        found, place = {}, 2 * n
        for i, (name, m) in enumerate(zip(task.names, self.nodes, strict=True)):
            part = slice(place, place + 10 * m)
            states, controls = np.split(outcome.x[part], [7 * m])
            states = states.reshape(m, 7) * STATE_UNITS
            controls = controls.reshape(m, 3)
            controls = np.clip(controls, [0.0, -1.0, -1.0], 1.0) * self.limits
            place += 10 * m
            times = to_nanoseconds(self.instants(arrivals, i))
            found[name] = Trajectory.of(task.plant, times, states, controls, 'linear')
        return found

    def guess_ways(self, task: FormationTask, bow: float) -> FormationGuess:
        """Quintic laws of time on the straight ways, bowed sideways by a share of them."""
        arrivals = _FIRST + task.interval * np.arange(task.n, dtype=np.float64)
        states, controls = [], []
        for i in range(task.n):
            t = self.instants(arrivals, i)
            s = np.polynomial.Polynomial([0.0, 1.0 / t[-1]])
            share, bulge = 10 * s**3 - 15 * s**4 + 6 * s**5, 16 * s**2 * (1 - s) ** 2
            way = task.goal[i] - task.start[i]
            side = bow * np.array([-way[1], way[0]])
            path = [task.start[i, k] + share * way[k] + bulge * side[k] for k in range(2)]
            yaw = task.yaw[i] + share * (task.goal_yaw[i] - task.yaw[i])
            x, y = path
            push = np.hypot(x.deriv(2)(t), y.deriv(2)(t))
            alpha = np.unwrap(np.arctan2(y.deriv(2)(t), x.deriv(2)(t))) - yaw(t)
            columns = [x, y, x.deriv(), y.deriv(), yaw, yaw.deriv()]
            states.append(np.stack([*(c(t) for c in columns), alpha], axis=1))
            torque = yaw.deriv(2)(t) * task.plant.inertia
            wanted = np.stack([push * task.plant.mass, np.gradient(alpha, t), torque], axis=1)
            controls.append(np.clip(wanted, self.limits * [0.0, -1.0, -1.0], self.limits))
        return FormationGuess(arrivals, states, controls)

    def guess_plan(self, task: FormationTask, plan: Mapping[str, Trajectory]) -> FormationGuess:
        """Return a plan as a guess."""
        arrivals = np.maximum.accumulate([plan[name].duration for name in task.names])
        states, controls = [], []
        for i, name in enumerate(task.names):
            sample = plan[name].sample(self.instants(arrivals, i))
            states.append(sample.state)
            controls.append(sample.control)
        return FormationGuess(arrivals, states, controls)


class RobotsCases(Cases):
    """The solvers of crossings of three robots."""

    deadline = 20.0
    collocation: FormationCollocation

    def __init__(self) -> None:
        super().__init__()
        # The cost is flat at its optimum: a tighter tolerance only costs time.
        self.collocation = FormationCollocation(
            self.problem(0).task, *INTERVALS, tol=1e-6, acceptable_tol=1e-4
        )
        self.guesses = {
            f'collocation, {name}': partial(self.collocation.guess_ways, bow=bow)
            for name, bow in BOWS.items()
        }

    def problem(self, case: int, near: bool = False) -> RobotFormation:
        """Return the crossing of a case, or one with starts nearby."""
        scenario = crossing(case)
        # Collocation keeps no reserve of the thrust either.
        values = scenario.parameters(**{'arena.tracking_margin': MARGIN, 'thrust_reserve': 0.0})
        if near:
            rng = np.random.default_rng([case, 7])
            for name in scenario.names:
                for axis in 'xy':
                    values[f'{name}.start.{axis}'] += float(rng.uniform(-_NEAR, _NEAR))
        return RobotFormation.from_parameters(values)

    @staticmethod
    def judge(
        task: FormationTask, motions: Mapping[str, Trajectory]
    ) -> tuple[tuple[str, ...], float]:
        """Return the reasons why motions are no manoeuvre, and J of (28) as they are flown."""
        reasons: list[str] = []
        limits = list(map(_with_slack, robot_constraints(task)))
        last = max(motion.duration for motion in motions.values())
        times, states = even_times(0.0, last, _RESOLUTION), []
        for i, name in enumerate(task.names):
            motion = motions[name]
            anywhere = np.full(7, np.inf)
            goal = goal_state(task, i)
            flight = ReplayedMotion(motion.times, partial(replay, task.plant, motion))
            given = task.plant, motion, flight, goal, TOLERANCE, limits
            checked = verify(*given, consistency=anywhere)
            reasons += checked.reasons
            own = np.union1d(times[times <= motion.duration], motion.times[-1])
            flown = replay(task.plant, motion, own)
            # who has arrived is parked
            states.append(flown[np.minimum(np.searchsorted(own, times), own.size - 1)])
        apart = list(map(_with_slack, separation_constraints(task)))
        none = np.zeros((times.size, 0))
        reasons += check(apart, times, np.concatenate(states, axis=1), none)[2]
        arrivals = np.array([motions[name].duration for name in task.names])
        gas = np.array([gas_used(task.plant, motions[name]) for name in task.names])
        return tuple(reasons), sum(task.cost_terms(arrivals, gas).values())


def _with_slack(limit: Constraint) -> Constraint:
    return replace(limit, tolerance=DISTANCE_SLACK) if limit.unit == 'm' else limit


def main() -> None:
    """Write the best cost that collocation finds from three guesses, for every crossing."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument('--scenarios', type=int, default=100)
    cases = RobotsCases()
    costs = {
        str(case): best_of([cases.collocate(name, case) for name in cases.guesses]).cost
        for case in range(arguments.parse_args().scenarios)
    }
    DATA.write_text(json.dumps({'robots': 3, 'costs': costs}, indent=1) + '\n')


if __name__ == '__main__':
    main()

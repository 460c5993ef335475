# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmark's swing-ups: by Hermite-Simpson collocation (CasADi, Ipopt), by this package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
import time
from typing import Any, NamedTuple

from benchmark.peers.attempts import Cases
from benchmark.peers.collocation import defects, Outcome, Solver
from benchmark.pendulum import problem, REGIMES, start_state
import casadi
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.plants.base import runge_kutta_step
from tdm_planner.plants.pendulum_replay import replay_pendulum
from tdm_planner.plants.rotary_pendulum import accelerations, RotaryPendulum
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.pendulum.task import PENDULUM_NAME, SwingUpTask
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from tdm_planner.verification import verify

INTERVALS = 50
# rad, rad/s: from there a linear feedback holds the pendulum.
TOLERANCE = np.array([0.05, 0.05, 0.5, 0.5])
DISK_SLACK = 0.01  # rad
_NEAR = np.array([0.05, 0.05, 0.25, 0.25])  # rad, rad/s: how far a neighbouring state is
_PUMPED, _STEP = 3.0, 2e-3  # s
_LONGEST = 200.0  # in 1 / w0
_INSIDE = 0.9  # of the limit: torques of an initial guess stay off their bounds


class Pumping(NamedTuple):
    """Gains of the energy controller, in units of the torque limit, rad and 1/w0."""

    energy: float
    angle: float
    rate: float


HARD = Pumping(1000.0, 0.0, 0.0)
GENTLE = Pumping(30.0, 1.0, 0.3)


def straight_line(task: SwingUpTask) -> Trajectory:
    """From the start straight to the nearest upright, without torque, in 6 / w0."""
    states = np.stack([task.start, task.goal_nearest(task.start)])
    duration = 6.0 / task.plant.natural_frequency
    return _motion(task, np.array([0.0, duration]), states, np.zeros(2))


def energy_swing(task: SwingUpTask, gains: Pumping) -> Trajectory:
    """
    Return the motion under energy pumping, up to where it comes nearest to upright at rest.

    The torque drives the pendulum's energy to that of upright (Astrom and Furuta, "Swinging up a
    pendulum by energy control", 2000) and the disk back to its zero.
    """
    plant, w0 = task.plant, task.plant.natural_frequency
    states, torques = [task.start], []
    for _ in range(int(_PUMPED / _STEP)):
        torques.append(_pump(states[-1], w0, gains) * task.planned_torque)
        states.append(runge_kutta_step(plant, states[-1], np.array([torques[-1]]), _STEP))
    path = np.array(states)
    away = path * np.array([1.0, 0.3, 1.0 / w0, 0.3 / w0])
    away[:, 0] -= 2 * np.pi * np.round(path[:, 0] / (2 * np.pi))
    last = int(np.argmin(np.linalg.norm(away, axis=1)[50:])) + 50
    times = _STEP * np.arange(last + 1, dtype=np.float64)
    return _motion(task, times, path[: last + 1], np.array([*torques[:last], 0.0]))


def _pump(state: Array, w0: float, gains: Pumping) -> float:
    theta, psi, rate, disk_rate = state.tolist()
    lack = 0.5 * (rate / w0) ** 2 + math.cos(theta) - 1.0
    drive = gains.energy * lack * (rate / w0 or 1e-3) * math.cos(theta)
    wanted: float = drive - gains.angle * psi - gains.rate * disk_rate / w0
    return max(-1.0, min(1.0, wanted))


def _motion(task: SwingUpTask, times: Array, states: Array, torques: Array) -> Trajectory:
    return Trajectory.of(task.plant, times, states, torques[:, None], 'linear')


casadi.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols give symbols


def dynamics(plant: RotaryPendulum, torque: float) -> Any:
    """Equations of motion with time in 1 / w0 and the control in units of `torque` [N m]."""
    w0 = plant.natural_frequency
    x, u = casadi.SX.sym('x', 4), casadi.SX.sym('u')
    theta, psi = accelerations(plant.coefficients, x[0], x[2] * w0, x[3] * w0, u * torque)
    rates = casadi.vertcat(x[2], x[3], theta / w0**2, psi / w0**2)
    return casadi.Function('f', [x, u], [rates])


class PendulumCollocation:
    """
    Swing-ups of one pendulum with one torque limit, on `intervals` equal intervals.

    The variables are the states and torques at the nodes and the final time; rates and times are
    in units of w0. `build_seconds` is the processor time of building program and solvers.
    """

    def __init__(self, task: SwingUpTask, intervals: int, **ipopt: Any) -> None:
        began = time.process_time()
        self.torque, self.disk_angle = task.planned_torque, task.disk_angle_limit
        self.intervals = n = intervals
        w0 = task.plant.natural_frequency
        self.unit = np.array([1.0, 1.0, w0, w0])
        x, u = casadi.MX.sym('x', 4, n + 1), casadi.MX.sym('u', 1, n + 1)
        total = casadi.MX.sym('T')
        rows, _ = defects(dynamics(task.plant, self.torque), x, u, casadi.repmat(total / n, 1, n))
        program = {'x': casadi.veccat(x, u, total), 'f': total, 'g': casadi.vec(rows)}
        self.solver = Solver(program, **ipopt)
        self.build_seconds = time.process_time() - began

    def solve(self, task: SwingUpTask, guess: Trajectory | Outcome, warm: bool = False) -> Outcome:
        """Solve from the start of `task` to the upright turn where the guess ends."""
        last = self.motions(task, guess)[PENDULUM_NAME] if isinstance(guess, Outcome) else guess
        n = self.intervals
        upper = np.full((n + 1, 4), np.inf)
        upper[:, 1] = self.disk_angle
        lower = -upper
        lower[0] = upper[0] = task.start / self.unit
        lower[-1] = upper[-1] = task.goal_nearest(last.states[-1]) / self.unit
        ones, zeros = np.ones(n + 1), np.zeros(4 * n)
        return self.solver.solve(
            guess if isinstance(guess, Outcome) else self.variables(guess),
            warm,
            lbx=np.concatenate([lower.ravel(), -ones, [0.1]]),
            ubx=np.concatenate([upper.ravel(), ones, [_LONGEST]]),
            lbg=zeros,
            ubg=zeros,
        )

    def variables(self, guess: Trajectory) -> Array:
        """Variables of the program at a guess."""
        states, torques = guess.sample(np.linspace(0.0, guess.duration, self.intervals + 1))
        shares = np.clip(torques[:, 0] / self.torque, -_INSIDE, _INSIDE)
        duration = guess.duration * self.unit[2]
        return np.concatenate([(states / self.unit).ravel(), shares, [duration]])

    def motions(self, task: SwingUpTask, outcome: Outcome) -> dict[str, Trajectory]:
        """Return the motion found, with the torques linear between its nodes."""
        n = self.intervals
        states = outcome.x[: 4 * (n + 1)].reshape(n + 1, 4) * self.unit
        _, shares, _ = np.split(outcome.x, [4 * (n + 1), 5 * (n + 1)])
        torques = np.clip(shares, -1.0, 1.0) * self.torque
        times = to_nanoseconds(np.linspace(0.0, outcome.x[-1] / self.unit[2], n + 1))
        return {PENDULUM_NAME: _motion(task, times, states, torques)}

    def guess_plan(self, task: SwingUpTask, plan: Mapping[str, Trajectory]) -> Trajectory:
        """Return a plan as a guess."""
        return plan[PENDULUM_NAME]


class PendulumCases(Cases):
    """The solvers of one torque limit."""

    deadline = 2.0

    def __init__(self, regime: str) -> None:
        self.torque = REGIMES[regime]
        super().__init__()
        self.collocation = PendulumCollocation(self.problem(0).task, INTERVALS)
        self.guesses = {
            'collocation, straight line': straight_line,
            'collocation, swing': lambda task: energy_swing(task, HARD),
            'collocation, slow swing': lambda task: energy_swing(task, GENTLE),
        }

    def problem(self, case: int, near: bool = False) -> PendulumSwingUp:
        """Return the swing-up of a case, or one from a state nearby."""
        away = np.random.default_rng([case, 7]).uniform(-1.0, 1.0, size=4) * _NEAR
        return problem(self.torque, start_state(case) + near * away)

    @staticmethod
    def judge(
        task: SwingUpTask, motions: Mapping[str, Trajectory]
    ) -> tuple[tuple[str, ...], float]:
        """Return the reasons why a motion is no swing-up, and how long it takes [s]."""
        motion = motions[PENDULUM_NAME]
        slack = {'torque': 1e-9 * task.torque_limit, 'disk_angle': DISK_SLACK}
        checked = verify(
            task.plant,
            motion,
            replay_pendulum(task.plant, motion),
            task.goal_nearest(motion.states[-1]),
            TOLERANCE,
            [replace(limit, tolerance=slack[limit.name]) for limit in task.constraints],
            consistency=np.full(4, np.inf),
        )
        return checked.reasons, motion.duration

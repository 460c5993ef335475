# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""One swing-up: boundary conditions and limits as numbers, and the check a plan must pass."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.parameters import parameter, Range, SIGNED, Validated
from tdm_planner.plants.pendulum_kernels import LANES, roll_ends
from tdm_planner.plants.pendulum_replay import replay_pendulum
from tdm_planner.plants.rotary_pendulum import mechanics, RotaryPendulum
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint, verify

TERMINAL_TOLERANCE = np.array([1e-4, 1e-4, 1e-3, 1e-3])
PENDULUM_NAME = 'pendulum'
WEAK_DRIVE = 0.3  # below which a failure is put down to the torque,
_LEAST_DRIVE = 1e-3  # and that below which a swing-up has more swings than are searched for
_RANGE_KEPT = 0.1  # share of the disk's range that is left to the feedback, by that of the torque
_LOSS = 0.02  # of the energy in half a swing, from which on it is told
_AT_FIRST = 4.0  # of 1/w0, or of the time in which the torque moves the disk by its range
_SWITCHES = 24  # intervals of the grid of either switch of the torque that turns the disk least
_PEAK_STEP, _PEAK = 0.1, 10.0  # of the time scale of the swings; times the limit, at which to end


@dataclass(frozen=True)
class PendulumStart(Validated):
    """State to start from."""

    theta: float = parameter(
        math.pi, "pendulum's angle from upright", unit='rad', allowed=Range(-1e6, 1e6)
    )
    psi: float = parameter(0.0, "disk's angle", unit='rad', allowed=SIGNED)
    theta_dot: float = parameter(
        0.0, "pendulum's angular velocity", unit='rad/s', allowed=Range(-1e4, 1e4)
    )
    psi_dot: float = parameter(
        0.0, "disk's angular velocity", unit='rad/s', allowed=Range(-1e4, 1e4)
    )
    torque: float | None = parameter(
        None,
        'torque from which methods smooth and virtual_arc go on without a jump; unset: any',
        unit='N m',
        allowed=SIGNED,
    )


@dataclass(frozen=True, eq=False)
class SwingUpTask:
    """
    From `start` (4,) to upright at rest, |T| <= `torque_limit`, |psi| <= `disk_angle_limit`.

    The search keeps within `planned_torque` and `planned_disk_angle`: the feedback uses the rest.
    `whole_range` gives all of the disk's range to the plan. `turns` is the number n of
    theta = 2 pi n at the end, None for whichever is reached first; `start_torque` the torque that
    a smooth motion goes on from, None for any.
    """

    plant: RotaryPendulum
    start: Array
    planned_torque: float
    torque_limit: float
    disk_angle_limit: float
    turns: int | None
    start_torque: float | None = None
    whole_range: bool = False

    @property
    def planned_disk_angle(self) -> float:
        """
        Limit of |psi| [rad] while planning.

        Where the disk's speed at the start leads beyond the reduced limit, the full one less 1e-5.
        """
        kept = (
            _RANGE_KEPT * (1.0 - self.planned_torque / self.torque_limit) * (not self.whole_range)
        )
        _, psi, _, psi_dot = self.start.tolist()
        stopped = abs(psi + psi_dot * abs(psi_dot) / (2.0 * self.disk_acceleration))
        most = (1.0 - 1e-5) * self.disk_angle_limit
        limit = most if stopped > (1.0 - kept) * most else (1.0 - kept) * most
        return float(max(abs(psi), limit))

    @property
    def drive(self) -> float:
        """Acceleration of the pendulum by the torque over that by gravity: weak below 1."""
        return self.plant.drive(self.planned_torque)

    @property
    def swing_drive(self) -> float:
        """Drive that swings can use: less than `drive` where the disk's range ends a stroke."""
        k = self.plant.coefficients
        return min(self.drive, self.planned_disk_angle * k.arm / k.pendulum)

    @property
    def disk_acceleration(self) -> float:
        """Acceleration that the torque gives the disk with the pendulum upright [rad/s^2]."""
        return self.plant.disk_acceleration(self.planned_torque)

    @property
    def transfer_time(self) -> float:
        """
        Time scale of the transfer [s]: how soon the torque could cover the distances alone.

        At most a thousand natural periods, however weak the torque.
        """
        k = self.plant.coefficients
        longest = 1e3 / self.plant.natural_frequency
        times = [0.0]
        error = np.abs(self.start - self.goal_nearest(self.start)).tolist()
        for inertia, distance, speed in ((k.arm, *error[::2]), (k.pendulum, *error[1::2])):
            acceleration = self.planned_torque * inertia / self.plant.determinant
            if acceleration * longest**2 < distance or acceleration * longest < speed:
                return longest
            times += [math.sqrt(distance / acceleration), speed / acceleration]
        return max(times)

    def least_peak(self, until: Budget) -> float:
        """
        Smallest peak of |psi| [rad] over a short horizon that a torque was found to lead to.

        Tried are the extreme torques with at most two switches, on a grid of 25 instants. Where
        the peak exceeds `disk_angle_limit`, there is probably no plan; that is no proof. NaN where
        there is not the time to try them all.
        """
        w0, limit = self.plant.natural_frequency, self.disk_angle_limit
        horizon = _AT_FIRST * math.sqrt(limit / max(self.disk_acceleration, limit * w0**2))
        one, more = np.triu_indices(_SWITCHES + 1)
        first = (one / _SWITCHES) ** 2
        second = np.minimum(first + ((more - one) / _SWITCHES) ** 1.5, 1.0)
        shares = np.stack([first, second - first, 1.0 - second], axis=1)
        durations = horizon * np.repeat(shares, 2, axis=0)
        torques = self.planned_torque * np.tile(
            [[1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]], (one.size, 1)
        )
        k, start, best = self.plant.coefficients, self.start, _PEAK * limit
        for begin in range(0, len(durations), LANES):  # a motion ends beyond the best so far
            if until.spent:  # the disk of some rigs turns in no time
                return math.nan
            some = slice(begin, begin + LANES)
            held = durations[some], torques[some], np.full(len(durations[some]), 3)
            best = min(best, *roll_ends(k, start, *held, _PEAK_STEP, best)[1].tolist())
            if best <= limit:
                break
        return best

    @property
    def unstoppable(self) -> str:
        """Say that no torque keeps the disk inside its limit."""
        return (
            f'no torque within {self.planned_torque:.3g} N m (limits.torque less torque_reserve) '
            f'keeps the disk inside limits.disk_angle = {self.disk_angle_limit:g} rad from '
            f'start.psi = {self.start[1]:g} rad, start.psi_dot = {self.start[3]:g} rad/s on'
        )

    @property
    def least_reach(self) -> float:
        """
        Lower bound of the largest |psi| [rad], whatever the torque.

        The momentum L = J psi' + B theta' and the place Q = psi + G(theta), G = int B/J d theta,
        follow L' = T, Q' = L / J: until L vanishes Q moves by L^2 / (2 T max J) at least. There is
        no bound, -inf, where damping stops the disk, too.
        """
        k = self.plant.coefficients
        if k.disk_damping > 0.0:
            return -math.inf
        theta, psi, theta_dot, psi_dot = self.start
        b, j, _, _ = mechanics(k, theta, theta_dot, psi_dot)
        upright, across = k.disk + k.disk_cosine, k.disk + k.disk_sine
        bend = math.sqrt(max(abs(across / upright - 1.0), 1e-12))
        inverse = np.arctan if across > upright else np.arctanh
        place, most = k.arm / upright / bend * inverse(bend * np.array([np.sin(theta), 1.0]))
        momentum = j * psi_dot + b * theta_dot
        moved = momentum**2 / (2.0 * self.planned_torque * max(upright, across))
        return float(np.sign(momentum) * (psi + place) + moved - most)

    @property
    def difficulties(self) -> str:
        """What makes a swing-up hard to find, to go on a sentence with; empty where nothing is."""
        damping, drive, found = self.plant.damping, self.drive, ''
        if self.turns is not None and (away := abs(self.turns - self.start[0] / math.tau)) > 1.0:
            found += f'; goal.turns = {self.turns} is {away:.3g} turns away: unset, any will do'
        if drive < _LEAST_DRIVE:
            found += (
                f'; with a drive of {drive:.2g} it takes more swings than are searched for: try a '
                f'limits.torque above {self.torque_limit * _LEAST_DRIVE / drive:.2g} N m'
            )
        elif self.swing_drive < min(drive, WEAK_DRIVE):
            found += (
                "; the disk's range limits what a swing gains: try a longer solver.deadline or "
                'more limits.disk_angle'
            )
        elif drive < WEAK_DRIVE:
            found += (
                f'; with a drive of {drive:.2g} it takes many swings, in each of which the disk '
                'turns: try a longer solver.deadline, more limits.torque or limits.disk_angle'
            )
        if 0.0 < self.planned_torque < damping.disk * self.plant.natural_frequency:
            found += (
                '; plant.damping.disk keeps the disk below '
                f'{self.planned_torque / damping.disk:.2g} rad/s'
            )
        if (loss := self.plant.loss) > _LOSS:
            found += f'; plant.damping.pivot takes {loss:.0%} of the energy in half a swing'
        return found

    def turns_nearest(self, state: Array) -> int:
        """
        Return the n of theta = 2 pi n to aim at from a state (4,).

        Raise FloatingPointError for a state whose numbers left the range in which they can be
        computed.
        """
        if not math.isfinite(state[0]):
            raise FloatingPointError(f'theta = {state[0]:g} rad')
        return round(float(state[0]) / (2 * math.pi)) if self.turns is None else self.turns

    def goal_nearest(self, state: Array) -> Array:
        """Return the goal (4,) to aim at from a state (4,): upright at rest."""
        return np.array([2 * math.pi * self.turns_nearest(state), 0.0, 0.0, 0.0])

    def plan(self, trajectory: Trajectory, parameters: Array, penalty: float) -> Solution:
        """Return the motion, whose replay is checked; J is the time it takes."""
        check = verify(
            self.plant,
            trajectory,
            replay_pendulum(self.plant, trajectory),
            self.goal_nearest(trajectory.states[-1]),
            TERMINAL_TOLERANCE,
            self.constraints,
            start=self.start,
        )
        return Solution(
            {PENDULUM_NAME: trajectory}, check, trajectory.duration, parameters, penalty
        )

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """Limits of a motion: torque and disk angle."""
        return (
            Constraint('torque', lambda t, x, u: self.torque_limit - np.abs(u[:, 0]), unit='N m'),
            Constraint(
                'disk_angle', lambda t, x, u: self.disk_angle_limit - np.abs(x[:, 1]), unit='rad'
            ),
        )

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
One manoeuvre into formation as arrays: boundary conditions, limits, arena, weights of (28).

Values that contradict each other raise InvalidProblem with one sentence.
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import math

import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.plants.floating_robot import FloatingRobot

# Planned distances exceed the required ones by this share, for what happens between instants.
_NUMERICAL_RESERVE = 0.01
# Robots nearer than this to their goal, and slower, have arrived already.
_ARRIVED = 1e-4
_ROUNDING = 1e-9
_AT_WALL = 2e-3  # m by which a robot that cannot stop sooner comes too near a wall
# Half-turns of the thruster: for which a robot goes on as it moved, and that a motion leaves time
# for, in initial guesses.
DRIFT, _TURNS = 1.5, 2.25


@dataclass(frozen=True, eq=False)
class FormationTask:
    """
    The manoeuvre of n robots; positions are between 0 and the arena's `sides` (2,), by axis.

    `start`, `velocity`, `acceleration`, `goal` (n, 2); `yaw`, `yaw_rate`, `yaw_acceleration`,
    `goal_yaw` (n,), the goal's on the turn that is to be made; `alpha` (n,) the angle of the
    thruster at the start, NaN where it is free; `coast` (n,) s the time every robot waits with
    its thrust off before its manoeuvre, while the thruster turns. Robots arrive at rest.

    `thrust` [m/s^2] and `torque` [rad/s^2] are the limits of (17), per mass and inertia, and
    `thruster_rate` [rad/s] the third. `obstacles` (m, 3) holds x, y, radius. `interval` is Delta_t
    of (28), `weights` w, `longest` the latest arrival considered [s], `shortest` the
    least time that polynomials are to take. `arrived` (n,) s is the time
    since which a robot that stays has been at its goal: the others keep their intervals to that.
    """

    names: tuple[str, ...]
    plant: FloatingRobot
    start: Array
    velocity: Array
    acceleration: Array
    yaw: Array
    yaw_rate: Array
    yaw_acceleration: Array
    alpha: Array
    goal: Array
    goal_yaw: Array
    thrust: float
    torque: float
    thruster_rate: float
    sides: Array
    separation: float
    margin: float
    obstacles: Array
    interval: float
    weights: Array
    longest: float
    coast: Array
    arrived: Array
    shortest: float = 0.0

    @property
    def n(self) -> int:
        """Return the number of robots."""
        return len(self.names)

    @property
    def staying(self) -> Mask:
        """Robots that are at their goal, at rest, and so only turn (n,)."""
        still = np.linalg.norm(self.velocity, axis=1) < _ARRIVED
        return np.asarray(still & (np.linalg.norm(self.goal - self.start, axis=1) < _ARRIVED))

    @property
    def half_turn(self) -> float:
        """Return the time that the thruster takes for half a turn [s]."""
        return math.pi / self.thruster_rate

    @property
    def departure(self) -> Array:
        """Positions when the manoeuvres begin, after coasting (n, 2)."""
        return self.start + self.velocity * self.coast[:, None]

    @property
    def departure_yaw(self) -> Array:
        """Attitudes when the manoeuvres begin, after coasting (n,)."""
        return self.yaw + self.yaw_rate * self.coast

    def _wanted_clearance(self, required: Array | float, ends: Array) -> Array:
        """
        Distances to plan for where `required` ones must be kept.

        The reserves are added, but no more than the distances at both `ends` allow.
        """
        wanted = (1.0 + _NUMERICAL_RESERVE) * required + self.margin
        return np.asarray(np.maximum(np.minimum(wanted, 0.999 * ends), required))

    def pair_clearances(self) -> Array:
        """Distances to plan for between all pairs of robots, in the order of their indices."""
        i, j = np.triu_indices(self.n, 1)
        at_start = np.linalg.norm(self.start[i] - self.start[j], axis=1)
        at_goal = np.linalg.norm(self.goal[i] - self.goal[j], axis=1)
        return self._wanted_clearance(self.separation, np.minimum(at_start, at_goal))

    def wall_bounds(self) -> tuple[Array, Array]:
        """Least and largest coordinates (n, 2) to plan for, on account of the walls."""
        half, ends = self.separation / 2, np.stack([self.start, self.goal])
        wanted = (1.0 + _NUMERICAL_RESERVE) * half + self.margin / 2
        low, high = ends.min(axis=0), self.sides - ends.max(axis=0)
        low, high = (np.maximum(np.minimum(wanted, away), half) for away in (low, high))
        return low, self.sides - high

    def zones(self) -> tuple[Array, Array]:
        """
        Centres (m, 2) of the keep-out zones, and distances to plan for (n, m).

        Half a separation is kept from their edge, as from the walls.
        """
        centres = self.obstacles[:, :2].copy()  # contiguous, as the kernels were compiled
        required = self.obstacles[:, 2] + self.separation / 2
        ends = np.minimum(
            np.linalg.norm(self.start[:, None] - centres, axis=2),
            np.linalg.norm(self.goal[:, None] - centres, axis=2),
        )
        return centres, self._wanted_clearance(required, ends)

    def cost_terms(self, arrivals: Array, gas: Array) -> dict[str, float]:
        """Return the weighted terms of (28): arrival times (n,) s, gas (n,) m/s."""
        time, sequence, gas_weight = self.weights
        arrivals = arrivals - self.arrived
        late = np.abs(np.diff(arrivals) - self.interval).sum()
        return {
            'time': float(time * arrivals[0]),
            'sequence': float(sequence * late),
            'gas': float(gas_weight * gas.sum()),
        }


def check_places(task: FormationTask, place: str, points: Array) -> None:
    """
    Check starts or goals (n, 2), which `place` says.

    Raise InvalidProblem if one is not allowed, naming the robot, and what is allowed.
    """
    half = task.separation / 2
    for name, point in zip(task.names, points, strict=True):
        for axis, value, side in zip('xy', point, task.sides, strict=True):
            if not half - _ROUNDING <= value <= side - half + _ROUNDING:
                raise InvalidProblem(
                    f"{place} of '{name}' has {axis} = {value:.4g} m, outside the arena: must be "
                    f'in [{half:g}, {side - half:g}] m (half of arena.minimum_separation from '
                    'the walls)'
                )
        for x, y, radius in task.obstacles:
            distance = math.dist(point, (x, y))
            if distance < radius + half - _ROUNDING:
                raise InvalidProblem(
                    f"{place} of '{name}' is {distance:.4g} m from the centre of the keep-out "
                    f'zone at ({x:g}, {y:g}) (arena.obstacles): must be at least '
                    f'{radius + half:g} m'
                )
    for (one, first), (other, second) in itertools.combinations(
        zip(task.names, points, strict=True), 2
    ):
        distance = math.dist(first, second)
        if distance < task.separation - _ROUNDING:
            raise InvalidProblem(
                f"{place}s of '{one}' and '{other}' are {distance:.4g} m apart: must be at least "
                f'arena.minimum_separation = {task.separation:g} m'
            )


def check_reach(task: FormationTask) -> None:
    """
    Check a lower bound of every arrival, along the straight way alone and of the turn, and walls.

    Raise Infeasible if a robot cannot be at its goal in time, or stop before a wall.
    """
    braking = task.velocity * np.abs(task.velocity) / (2.0 * task.thrust)
    half, rest = task.separation / 2, task.start + braking
    near = np.maximum(half - rest, rest - (task.sides - half))
    if near.max(initial=0.0) > _AT_WALL:
        robot, axis = divmod(int(near.argmax()), 2)
        raise Infeasible(
            f"'{task.names[robot]}' cannot stop before the wall from start.{'uv'[axis]} = "
            f'{task.velocity[robot, axis]:.3g} m/s: with limits.thrust it comes '
            f'{near[robot, axis]:.3g} m nearer than half of arena.minimum_separation'
        )
    away = task.goal - task.start
    way = np.linalg.norm(away, axis=1)
    speed = np.linalg.norm(task.velocity, axis=1)
    along = (task.velocity * away).sum(axis=1) / np.maximum(way, 1e-12)
    moving = np.maximum(least_time(way, along, task.thrust), speed / task.thrust)
    turning = least_time(task.goal_yaw - task.yaw, task.yaw_rate, task.torque)
    least = np.maximum(moving, turning)
    if least.max(initial=0.0) > task.longest:
        robot = int(np.argmax(least))
        raise Infeasible(
            f"goal of '{task.names[robot]}' cannot be reached within solver.longest = "
            f'{task.longest:g} s: at least {least[robot]:.3g} s are needed with limits.thrust and '
            'limits.torque'
        )


def least_time(way: Array, rate: Array, acceleration: float) -> Array:
    """
    Shortest time [s] to cover `way` (n,) on a line and stop, from the rate `rate` (n,).

    The double integrator's bang-bang time: speed up and brake, or brake and come back.
    """
    way, rate = np.where(way < 0, -way, way), np.where(way < 0, -rate, rate)
    overshoot = rate * np.abs(rate) / (2 * acceleration) - way
    peak = np.sqrt(np.maximum(acceleration * way + rate**2 / 2, 0.0))
    direct = (2 * peak - rate) / acceleration
    back = rate / acceleration + 2 * np.sqrt(np.maximum(overshoot, 0.0) / acceleration)
    return np.where(overshoot > 0, back, direct)


def first_arrival(task: FormationTask, least: Array, thrust: float) -> float:
    """
    Arrival of the first robot [s] that (28) prefers, were all ways straight and free.

    No robot takes less than `least` (n,) s; `thrust` [m/s^2] is what they burn and coast with.
    """
    drift = DRIFT * task.half_turn * task.velocity
    way = np.linalg.norm(task.goal - task.departure - drift, axis=1)
    speed = np.linalg.norm(task.velocity, axis=1)
    later = task.interval * np.arange(task.n) - task.coast
    # Of a short way the thruster's turns, before the first burn and the last one, take longer.
    least = np.where(task.staying, least, np.maximum(least, _TURNS * task.half_turn))
    quickest = np.maximum(np.sqrt(4.4 * way / thrust) + 2.0 * speed / thrust, least)
    first = max(float((quickest - later).max()), 0.02)
    times = np.geomspace(first, max(task.longest, 1.01 * first), 200)
    lasting = times[:, None] + later
    root = np.sqrt(np.maximum(0.25 * lasting**2 - way / thrust, 0.0))
    gas = 2.0 * thrust * (0.5 * lasting - root)
    cost = task.weights[0] * times + 1.1 * task.weights[2] * gas.sum(axis=1)
    return float(times[np.argmin(cost)])

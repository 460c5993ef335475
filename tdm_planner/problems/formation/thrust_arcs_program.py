# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The program of robots that fly rounded polylines: exact gas; its motions written out, and back.

Varied are, of every robot, the start of its first burn, corners and their instants, and the
arrival; goals are reached exactly whatever they are, see `thrust_arcs_kernels`.

Written out, controls are held, every switch a sample. The thruster turns as soon as a burn is
over, rests while the robot coasts, and holds the thrust's direction in the arena while it burns.
Back: polylines are fitted to earlier plans, or go on with what is left of them.
"""

from __future__ import annotations

from collections.abc import Mapping
import math

import numpy as np
from scipy.optimize import least_squares
from tdm_planner.arrays import Array
from tdm_planner.problems.formation import thrust_arcs_kernels
from tdm_planner.problems.formation.polynomial_plan import follow
from tdm_planner.problems.formation.program import FormationProgram
from tdm_planner.problems.formation.task import first_arrival, FormationTask, least_time
from tdm_planner.problems.formation.verification import flown
from tdm_planner.trajectory import to_nanoseconds, Trajectory

_RATE_SHARE = 0.97  # of the thruster's rate, with which turns are reckoned
_SPEED = 0.02  # of a typical speed, by which |p| is rounded off
_PAUSE = 1e-3  # of a typical duration: the shortest coast
_FREELY = 20.0  # times the unit of other arrivals, that of robots that stay
_THERE = 0.01  # of a typical duration, in which robots that stay are at their goals
_SAMPLES = 50  # of a motion at least, for those that draw it or follow it
_TURNED = 2e-5  # rad: how far a held rate may let the thrust turn from its direction in a burn
_GENTLE = 0.5  # of the thruster's rate, with which it turns where there is time
_FULL = 0.9999  # of the thruster's rate
_LEAST_SPACING = 5e-9  # s: samples nearer than that are one
_MISSED = 1e-11  # m, m/s: what is left of an error of the end
_CORRECTIONS = 8
_DIGITS = 11  # of a rate [rad/s]: less is rounding, and no switch
_INSTANTS = 40  # at which a polyline is fitted to a plan
_EVALUATIONS = 8
_WIDTH = 1e-9  # m, s between bounds at least, as in an aisle just as wide as a robot needs
_OF_TASK = ('goal', 'alpha', 'yaw', 'yaw_rate', 'goal_yaw')
_CORRECTED = 0.6  # half-turns of the thruster before a burn that leave time for another one


class ThrustArcProgram(FormationProgram):
    """
    The program of one manoeuvre with `count` burns a robot.

    Robots that stay vary their arrival only, and those with `kept` motions, by name, nothing.
    """

    kernels = thrust_arcs_kernels
    curvature = 2e-3, 0.0

    def __init__(
        self, task: FormationTask, count: int = 3, kept: Mapping[str, Trajectory] | None = None
    ) -> None:
        self.limits = {"the time that the thruster of '{}' needs between burns": count}
        kept = kept or {}
        turn = task.goal_yaw - task.yaw
        # Torque, and a thruster that holds its direction, allow no earlier arrivals.
        holding = 2.0 * np.abs(turn) / (_RATE_SHARE * task.thruster_rate)
        least = np.maximum(least_time(turn, task.yaw_rate, 0.999 * task.torque), holding)
        first = first_arrival(task, least, task.thrust)
        length, time = 1.25 * float(task.separation), 0.25 * first
        units = np.tile([time, *[length, length, time] * (count - 2), time], (task.n, 1))
        units[task.staying, -1] *= _FREELY  # nothing bends along with these
        last = np.arange(units.shape[1]) == units.shape[1] - 1
        robots = np.isin(task.names, list(kept))
        super().__init__(task, first, units, 1.0 * last, last, robots)
        way = np.linalg.norm(task.goal - task.start, axis=1).mean()
        typical = max(float(way), 0.1 * task.separation) / first
        typical = max(typical, float(np.linalg.norm(task.velocity, axis=1).mean()))
        held, fixed = np.zeros((len(self.clearances), count, 4)), np.zeros(units.shape)
        for robot in np.flatnonzero(robots):
            motion = kept[task.names[robot]]
            burns = remaining(motion)
            held[robot, : len(burns)], fixed[robot, -1] = burns, motion.duration
        self.manoeuvre = thrust_arcs_kernels.Fleet(
            start=np.concatenate([task.start, self.centres]),
            velocity=np.concatenate([task.velocity, np.zeros_like(self.centres)]),
            clearances=self.clearances,
            held=held,
            **{name: np.ascontiguousarray(getattr(task, name)) for name in _OF_TASK},
            varied=self.varied,
            thrust=float(task.thrust),
            rate=_RATE_SHARE * float(task.thruster_rate),
            pause=_PAUSE * first,
            speed=_SPEED * typical,
            length=length,
            time=time,
            interval=self.interval,
        )
        lower, upper = np.zeros(units.shape), np.full(units.shape, task.longest)
        for w in range(1, self.size - 1, 3):
            lower[:, [w, w + 1]], upper[:, [w, w + 1]] = self.low, self.high
        lower[:, -1] = np.maximum(least, _THERE * first)
        waiting = task.staying & (task.arrived > 0.0)
        upper[waiting, -1] = lower[waiting, -1]
        self.bound(lower, upper, fixed)


def cleaned(
    task: FormationTask, robot: int, burns: Array, duration: float, weakest: float
) -> Array:
    """
    Burns (k, 4) without those that change the velocity by less than `weakest` m/s.

    The others, two at least, are corrected so that the robot rests at its goal after `duration`.
    """
    sizes = np.hypot(burns[:, 0], burns[:, 1])
    keep = np.zeros(sizes.size, dtype=bool)
    keep[np.argsort(sizes, kind='stable')[-2:]] = True
    keep |= sizes >= weakest
    found = burns[keep]
    ends = np.flatnonzero(keep)
    first, last = ends == 0, ends == sizes.size - 1
    begin = burns[0, 2] - burns[0, 3]
    velocity = task.velocity[robot]
    way = task.goal[robot] - task.start[robot] - velocity * duration
    for _ in range(_CORRECTIONS):
        p = found[:, :2]
        half = np.hypot(p[:, 0], p[:, 1]) / (2.0 * task.thrust)
        found[:, 3] = half
        found[first, 2] = begin + half[first]
        found[last, 2] = duration - half[last]
        left = duration - found[:, 2]
        missed = np.concatenate([way - left @ p, -velocity - p.sum(axis=0)])
        if np.abs(missed).max() < _MISSED:
            break
        bend = np.where(first, -1.0, np.where(last, 1.0, 0.0)) / (2.0 * task.thrust)
        unit = p / np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-12)[:, None]
        slopes = left[:, None, None] * np.eye(2)
        slopes = slopes + bend[:, None, None] * unit[:, :, None] * p[:, None]
        rows = np.concatenate([slopes, np.broadcast_to(np.eye(2), slopes.shape)], axis=1)
        rows = np.swapaxes(rows, 0, 1).reshape(4, -1)
        # Instants are worth more than velocities: both in metres.
        scale = np.array([1.0, 1.0, duration, duration])
        change = np.linalg.lstsq(rows * scale[:, None], missed * scale, rcond=1e-9)[0]
        found[:, :2] += change.reshape(-1, 2)
    return found


def arc_trajectory(task: FormationTask, robot: int, burns: Array, duration: float) -> Trajectory:
    """Return the held controls of a robot's burns (k, 4), and the states that follow."""
    plant = task.plant
    yaw, rate, goal = task.yaw[robot], task.yaw_rate[robot], task.goal_yaw[robot]
    a, switch = thrust_arcs_kernels.turning(duration, goal - yaw, rate)
    spin = duration, a, switch, yaw, rate, goal
    on = np.stack([burns[:, 2] - burns[:, 3], burns[:, 2] + burns[:, 3]], axis=1)
    on = np.clip(on, 0.0, duration)
    path = _thruster_path(task, robot, burns, on, spin)
    edges = [0.0, duration, *on.ravel(), *path[0], *np.linspace(0.0, duration, _SAMPLES)]
    if 0.0 < switch < duration:
        edges.append(switch)
    times = np.unique(to_nanoseconds(np.array(edges)))
    times = times[np.concatenate([[True], np.diff(times) > _LEAST_SPACING])]
    alpha, unlimited = np.interp(times, *path), np.full(times.size, np.inf)
    reach = _FULL * task.thruster_rate * np.diff(times)
    follow(alpha, -unlimited, unlimited, reach, alpha[0], alpha)
    middle = 0.5 * (times[1:] + times[:-1])
    burning = ((middle[:, None] > on[:, 0]) & (middle[:, None] < on[:, 1])).any(axis=1)
    controls = np.zeros((times.size, 3))
    controls[:-1, 0] = plant.mass * task.thrust * burning
    controls[:-1, 1] = np.round(np.diff(alpha) / np.diff(times), _DIGITS)
    controls[:-1, 2] = plant.inertia * np.where(middle < switch, a, -a)
    return flown(task, robot, times, controls, alpha[0], 'zero_order_hold')


def _thruster_path(
    task: FormationTask, robot: int, burns: Array, on: Array, spin: tuple[float, ...]
) -> tuple[Array, Array]:
    """Instants and angles of the thruster between which it turns evenly, at any rate."""
    now, angle = 0.0, float(task.alpha[robot])
    times, angles = [], []
    if not math.isnan(angle):
        times, angles = [0.0], [angle]
    step = math.sqrt(8.0 * _TURNED / max(abs(spin[1]), 1e-12))
    for burn, (begin, end) in zip(burns, on, strict=True):
        count = 1 + max(1, math.ceil((end - begin) / step))
        instants = np.linspace(begin, end, count)
        yaw = np.array([thrust_arcs_kernels.attitude(t, *spin) for t in instants])
        held = math.atan2(burn[1], burn[0]) - yaw
        if math.isnan(angle):
            angle = held[0]
        held += 2.0 * math.pi * round((angle - held[0]) / (2.0 * math.pi))
        turn = abs(held[0] - angle)
        if begin > now and turn > 0.0:
            speed = max(_GENTLE * task.thruster_rate, turn / (begin - now))
            times.append(now + turn / speed)
            angles.append(held[0])
        known = 1 if times and begin <= times[-1] else 0  # burning from the start
        times.extend(instants[known:])
        angles.extend(held[known:])
        now, angle = end, held[-1]
    if not times:
        times, angles = [0.0], [0.0]
    return np.array(times), np.array(angles)


def fitted(program: ThrustArcProgram, plans: Mapping[str, Trajectory]) -> Array:
    """Parameters (n, v) whose motions are nearest to planned ones at equal times, as long."""
    lower, upper = program.full(program.lower), program.full(program.upper)
    found = [
        _nearest(program, i, plans[name], lower[i], upper[i])
        for i, name in enumerate(program.task.names)
    ]
    return np.stack(found)


def _nearest(
    program: ThrustArcProgram, i: int, plan: Trajectory, lower: Array, upper: Array
) -> Array:
    """Parameters (v,) of robot i, within bounds, that fit its plan."""
    duration = float(np.clip(plan.duration, lower[-1], upper[-1]))
    if not program.varied[i]:
        return np.append(np.zeros(program.size - 1), duration)
    times = np.linspace(0.0, duration, _INSTANTS)
    wanted = plan.sample(times).state[:, :2]
    every = program.manoeuvre.held.copy()
    burns, slopes = every[i], np.zeros((*every.shape[1:], program.size))

    def missed(z: Array) -> Array:
        thrust_arcs_kernels.round_off(np.append(z, duration), program.manoeuvre, i, burns, slopes)
        return np.asarray(
            (thrust_arcs_kernels.positions(times, program.manoeuvre, i, every) - wanted).ravel()
        )

    corners = np.arange(1, program.size - 1, 3)
    share = np.arange(1, corners.size + 1) / (corners.size + 1)
    low, high = lower[:-1].copy(), upper[:-1].copy()
    high[0] = 0.2 * duration
    low[corners + 2] = (share - 0.65 / (corners.size + 1)) * duration
    high[corners + 2] = (share + 0.65 / (corners.size + 1)) * duration
    first = np.zeros(program.size - 1)
    start = plan.sample(share * plan.duration).state
    first[corners], first[corners + 1] = start[:, 0], start[:, 1]
    first[corners + 2] = share * duration
    high = np.maximum(high, low + _WIDTH)
    room = 1e-6 * (high - low)
    first = np.clip(first, low + room, high - room)
    best = least_squares(missed, first, bounds=(low, high), max_nfev=_EVALUATIONS)
    return np.append(best.x, duration)


def remaining(plan: Trajectory) -> Array:
    """Burns (k, 4) of a plan whose thrust is on or off, as `thrust_arcs_kernels` has them."""
    on = plan.control('thrust')[:-1] > 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    begin, end = plan.times[edges[::2]], plan.times[edges[1::2]]
    velocity = np.stack([plan.state('u'), plan.state('v')], axis=1)
    change = velocity[edges[1::2]] - velocity[edges[::2]]
    return np.column_stack([change, 0.5 * (begin + end), 0.5 * (end - begin)])


def resumed(
    task: FormationTask, plans: Mapping[str, Trajectory], kept: Mapping[str, Trajectory]
) -> Array:
    """
    Parameters (n, v) that go on with the rest of plans, with as many burns as they have.

    Goals are reached from where the rest of a plan turns last; the start may be off it. Robots
    whose motion is `kept` need none.
    """
    rests = {
        i: remaining(plans[name])
        for i, name in enumerate(task.names)
        if not task.staying[i] and name not in kept
    }
    corners = max([1, *(len(rest) - 2 for rest in rests.values())])
    found = np.zeros((task.n, 3 * corners + 2))
    for i, name in enumerate(task.names):
        found[i, -1] = plans[name].duration
        if i not in rests or not len(rests[i]):
            continue
        rest = rests[i]
        begin, end = rest[:, 2] - rest[:, 3], rest[:, 2] + rest[:, 3]
        turns = rest[1:-1, 2].tolist()
        found[i, 0], after = begin[0], end[0]
        if len(rest) == 1:
            found[i, 0] = after = min(task.half_turn, 0.45 * begin[0])
        elif begin[0] > _CORRECTED * task.half_turn and len(turns) < corners:
            # There is time to correct before.
            found[i, 0] = after = min(task.half_turn, 0.45 * begin[0])
            turns.insert(0, rest[0, 2])
        while len(turns) < corners:
            turns.append(0.5 * ((turns[-1] if turns else after) + begin[-1]))
        for k, instant in enumerate(turns):
            left = np.maximum(rest[:, 2] - instant, 0.0)
            place = task.goal[i] + left @ rest[:, :2]
            found[i, np.arange(3) + 1 + 3 * k] = [*place, instant]
    return found

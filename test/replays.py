# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plans replayed with nothing of the package: from the JSON alone, by equations written out here.

By the classical Runge-Kutta method, with limits looked at after every step. Slopes by `central`.
`by_scipy` integrates a plant of the package along its plan.
"""

from collections.abc import Callable, Iterator
import itertools
import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from tdm_planner.trajectory import ReplayedMotion

State = list[float]

# What is promised of every plan. Ends: rad, rad/s; m, m/s, rad, rad/s. Controls: relative; disk
# angle: rad; distances: m. The last two allow for what happens between the instants of the check.
PENDULUM_END = {'theta': 1e-4, 'psi': 1e-4, 'theta_dot': 1e-3, 'psi_dot': 1e-3}
ROBOT_END = {'x': 3.5e-3, 'y': 3.5e-3, 'u': 5e-3, 'v': 5e-3, 'yaw': 1e-2, 'omega': 1e-2}
ROBOT_START, RELATIVE, ANGLE, DISTANCE = 1.001e-5, 2e-6, 1e-5, 2e-5


def pendulum_rates(p: dict[str, float]) -> Callable[[State, list[float]], State]:
    """
    Equations of motion of the rotary pendulum, by its mass matrix.

    [A, B; B, J] (theta'', psi'') = (r1, r2), as Cazzolato and Prime (2011) derive them.
    """
    mass, length = p['plant.mass'], p['plant.com_distance']
    arm, gravity = p['plant.arm_length'], p['plant.gravity']
    ix, iy, iz = (p[f'plant.inertia.{axis}'] for axis in 'xyz')
    disk = p['plant.inertia.disk']
    pivot, bearing = p['plant.damping.pivot'], p['plant.damping.disk']

    def rates(state: State, control: list[float]) -> State:
        theta, _, w, q = state
        s, c = math.sin(theta), math.cos(theta)
        a = iz + mass * length**2
        b = mass * length * arm * c
        j = disk + mass * arm**2 + (ix + mass * length**2) * s * s + iy * c * c
        k = ix - iy + mass * length**2
        r1 = k * s * c * q * q + mass * gravity * length * s - pivot * w
        r2 = control[0] - 2 * k * s * c * w * q + mass * length * arm * s * w * w - bearing * q
        d = a * j - b * b
        return [w, q, (j * r1 - b * r2) / d, (a * r2 - b * r1) / d]

    return rates


def robot_rates(p: dict[str, float]) -> Callable[[State, list[float]], State]:
    """Equation (17): thrust along yaw + alpha, torque of the wheel, turning of the thruster."""
    mass, inertia = p['plant.mass'], p['plant.inertia']

    def rates(state: State, control: list[float]) -> State:
        _, _, u, v, yaw, omega, alpha = state
        thrust, turning, torque = control
        push, heading = thrust / mass, yaw + alpha
        forces = push * math.cos(heading), push * math.sin(heading)
        return [u, v, *forces, omega, torque / inertia, turning]

    return rates


def replayed(plan: Any, rates: Any, longest_step: float) -> Iterator[tuple[float, State, list]]:
    """Yield time, state and controls after every step, from the plan's first state."""
    times, kind = plan['times'], plan['interpolation']
    rows = list(zip(*plan['controls'].values(), strict=True))
    state = [column[0] for column in plan['states'].values()]
    yield times[0], state, list(rows[0])
    spline = CubicSpline(times, rows) if kind == 'cubic' else None
    for k in range(len(times) - 1):
        span = times[k + 1] - times[k]
        assert span > 0
        between = _between(kind, rows[k], rows[k + 1], span, spline, times[k])
        steps = math.ceil(span / longest_step)
        h = span / steps
        for i in range(steps):
            t = i * h
            u0, u1, u2 = between(t), between(t + h / 2), between(t + h)
            k1 = rates(state, u0)
            k2 = rates([x + h / 2 * d for x, d in zip(state, k1, strict=True)], u1)
            k3 = rates([x + h / 2 * d for x, d in zip(state, k2, strict=True)], u1)
            k4 = rates([x + h * d for x, d in zip(state, k3, strict=True)], u2)
            slopes = zip(k1, k2, k3, k4, strict=True)
            ways = [h / 6 * (a + 2 * (b + c) + d) for a, b, c, d in slopes]
            state = [x + way for x, way in zip(state, ways, strict=True)]
            yield times[k] + t + h, state, u2


def by_scipy(plant: Any, plan: Any) -> ReplayedMotion:
    """Return what `verify` takes, integrated from sample to sample."""
    pieces, state, holds = [], plan.states[0], plan.interpolation == 'zero_order_hold'
    for first, last, held in zip(plan.times[:-1], plan.times[1:], plan.controls, strict=False):
        found = solve_ivp(
            lambda t, x, u: plant.derivative(x, plan.controls_at(t) if u is None else u),
            (first, last), state, args=(held if holds else None,), method='DOP853',
            rtol=1e-9, atol=1e-11, dense_output=True,
        )  # fmt: skip
        assert found.success
        pieces.append(found.sol)
        state = found.y[:, -1]

    def states(times: Any) -> Any:
        at = np.searchsorted(plan.times[1:-1], times)
        return np.array([pieces[piece](t) for piece, t in zip(at, times, strict=True)])

    return ReplayedMotion(np.unique(np.concatenate([piece.ts for piece in pieces])), states)


def _between(kind: str, first: Any, last: Any, span: float, spline: Any, start: float) -> Any:
    return {
        'linear': lambda t: [a + (b - a) * t / span for a, b in zip(first, last, strict=True)],
        'cubic': lambda t: spline(start + t).tolist(),
        'zero_order_hold': lambda t: first,
    }[kind]


def pendulum_faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with a plan of the pendulum; empty if nothing is."""
    p, found = document['parameters'], dict[str, tuple[float, float]]()  # what is, and is allowed
    torque, angle = p['limits.torque'], p['limits.disk_angle']
    quickest = max(map(abs, document['states']['theta_dot']), default=0.0)
    step = min(5e-4, 5e-3 / max(quickest, 1e-3))  # many swings magnify errors
    every = [(x, u[0], x[1]) for _, x, u in replayed(document, pendulum_rates(p), step)]
    state, torques, angles = every[-1][0], *np.abs([row[1:] for row in every]).T
    found['torque'] = torques.max(), torque * (1 + RELATIVE)
    found['disk angle'] = angles.max(), angle + ANGLE * max(1.0, angle)
    turns = round(state[0] / math.tau) if p['goal.turns'] is None else p['goal.turns']
    end = [state[0] - math.tau * turns, *state[1:]]
    for (name, allowed), error in zip(PENDULUM_END.items(), end, strict=True):
        away = document['states'][name][0] - p[f'start.{name}']
        found[f'end of {name}'] = abs(error), 1.001 * allowed
        found[f'start of {name}'] = abs(away), 1.001 * allowed
    return _beyond(found)


def _beyond(found: dict[str, tuple[float, float]], whose: str = '') -> list[str]:
    """Return what is more than allowed, or no number."""
    return [f'{whose}{what}: {x} of {y}' for what, (x, y) in found.items() if not x <= y]


def formation_faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with a plan of robots; empty if nothing is."""
    p, faults, paths = document['parameters'], list[str](), {}
    if list(document['robots']) != p['robots']:
        return [f'the robots are {list(document["robots"])}']
    last = max(plan['times'][-1] for plan in document['robots'].values())
    for name, plan in document['robots'].items():
        path, found = _robot_faults(name, plan, p)
        faults += found
        paths[name] = _on_grid(path, last)
    for one, other in itertools.combinations(paths, 2):
        nearest = np.hypot(*(paths[one] - paths[other]).T).min()
        if not nearest >= p['arena.minimum_separation'] - DISTANCE:
            faults.append(f'{one} and {other} come within {nearest} m')
    return faults


def _robot_faults(name: str, plan: dict[str, Any], p: dict[str, Any]) -> tuple[list, list[str]]:
    path, half, flat = [], p['arena.minimum_separation'] / 2, p['arena.obstacles']
    thrust, rate, torque = (p[f'limits.{k}'] for k in ('thrust', 'thruster_rate', 'torque'))
    zones = list(zip(flat[::3], flat[1::3], flat[2::3], strict=True))
    controls, distances = [0.0], [0.0]  # the largest excess
    for time, state, (f, d, t) in replayed(plan, robot_rates(p), 5e-3):
        x, y = state[:2]
        path.append((time, state))
        controls += [f / thrust - 1, -f / thrust, abs(d) / rate - 1, abs(t) / torque - 1]
        distances += [half - side for side in (x, y, p['arena.length'] - x, p['arena.width'] - y)]
        distances += [half + r - math.hypot(x - zx, y - zy) for zx, zy, r in zones]
    found = {'actuators': (max(controls), RELATIVE), 'walls or zones': (max(distances), DISTANCE)}
    for axis, end, goal in zip(ROBOT_END, state, _goal(name, p), strict=False):
        away = math.remainder(end - goal, math.tau) if axis == 'yaw' else end - goal
        found[f'end of {axis}'] = abs(away), 1.001 * ROBOT_END[axis]
        away = plan['states'][axis][0] - p[f'{name}.start.{axis}']
        found[f'start of {axis}'] = abs(away), ROBOT_START
    return path, _beyond(found, f'{name}: ')


def _goal(name: str, p: dict[str, Any]) -> State:
    x, y, turn = p['formation.anchor']
    dx, dy, dyaw = p[f'formation.{name}']
    c, s = math.cos(turn), math.sin(turn)
    return [x + c * dx - s * dy, y + s * dx + c * dy, 0.0, 0.0, turn + dyaw, 0.0]


def _on_grid(path: list[tuple[float, State]], last: float) -> Any:
    """Places at common instants 5 ms apart, linear between the steps; parked after the end."""
    times = np.array([time for time, _ in path])
    places = np.array([state[:2] for _, state in path])
    grid = np.linspace(0.0, last, math.ceil(last / 5e-3) + 1)
    return np.stack([np.interp(grid, times, places[:, k]) for k in (0, 1)], axis=1)


FAULTS = {'pendulum_swing_up': pendulum_faults, 'robot_formation': formation_faults}


def faults(document: dict[str, Any]) -> list[str]:
    return FAULTS[document['problem']](document)


def pendulum_points(plant: Any, theta: Any, psi: Any) -> tuple[Any, Any]:
    """
    Positions of the pendulum's pivot and tip, (..., 3) m, about the disk's centre, z up.

    theta turns the rod, twice as long as its centre of mass is far, towards +y of the disk.
    """
    theta, psi = np.broadcast_arrays(theta, psi)
    zero, sine, s, c = np.zeros_like(psi), np.sin(theta), np.sin(psi), np.cos(psi)
    pivot = plant.arm_length * np.stack([c, s, zero], axis=-1)
    rod = np.stack([-sine * s, sine * c, np.cos(theta)], axis=-1)
    return pivot, pivot + 2.0 * plant.com_distance * rod


def central(function: Callable[[Any], Any], at: Any, step: float = 1e-6) -> Any:
    """Return the derivative (..., n) of a function (...) of n numbers."""
    changes = step * np.eye(len(at))
    slopes = [np.subtract(function(at + h), function(at - h)) / (2 * step) for h in changes]
    return np.stack(slopes, axis=-1)

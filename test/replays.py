# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plans replayed with nothing of the package: from the JSON alone, by equations written out here.

The classical Runge-Kutta method with steps of at most 0.5 ms (pendulum) and 5 ms (robots) between
all samples; limits are looked at after every step.
"""

from collections.abc import Callable, Iterator
import math
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

State = list[float]
Controls = Callable[[float], list[float]]

# What is promised of every plan. Ends: rad, rad/s; m, m/s, rad, rad/s. Controls: relative; disk
# angle: rad; distances: m. The last two allow for what happens between the instants of the check.
PENDULUM_END = {'theta': 1e-4, 'psi': 1e-4, 'theta_dot': 1e-3, 'psi_dot': 1e-3}
ROBOT_END = {'x': 3.5e-3, 'y': 3.5e-3, 'u': 5e-3, 'v': 5e-3, 'yaw': 1e-2, 'omega': 1e-2}
ROBOT_START = 1.001e-5
RELATIVE = 2e-6
ANGLE = 1e-5
DISTANCE = 2e-5


def pendulum_rates(p: dict[str, float]) -> Callable[[State, list[float]], State]:
    """
    Equations of motion of the rotary pendulum, by its mass matrix.

    [A, B; B, J] (theta'', psi'') = (r1, r2), as Cazzolato and Prime (2011) derive them.
    """
    mass, length = p['plant.mass'], p['plant.com_distance']
    arm, gravity = p['plant.arm_length'], p['plant.gravity']
    ix, iy, iz = (p[f'plant.inertia.{axis}'] for axis in 'xyz')
    disk = p['plant.inertia.disk']

    def rates(state: State, control: list[float]) -> State:
        theta, _, w, q = state
        s, c = math.sin(theta), math.cos(theta)
        a = iz + mass * length**2
        b = mass * length * arm * c
        j = disk + mass * arm**2 + (ix + mass * length**2) * s * s + iy * c * c
        k = ix - iy + mass * length**2
        r1 = k * s * c * q * q + mass * gravity * length * s
        r2 = control[0] - 2 * k * s * c * w * q + mass * length * arm * s * w * w
        d = a * j - b * b
        return [w, q, (j * r1 - b * r2) / d, (a * r2 - b * r1) / d]

    return rates


def robot_rates(p: dict[str, float]) -> Callable[[State, list[float]], State]:
    """Equation (17): thrust along yaw + alpha, torque of the wheel, turning of the thruster."""
    mass, inertia = p['plant.mass'], p['plant.inertia']

    def rates(state: State, control: list[float]) -> State:
        _, _, u, v, yaw, omega, alpha = state
        thrust, turning, torque = control
        heading = yaw + alpha
        push = thrust / mass
        return [
            u, v, push * math.cos(heading), push * math.sin(heading),
            omega, torque / inertia, turning,
        ]  # fmt: skip

    return rates


def replayed(
    plan: dict[str, Any], rates: Callable[[State, list[float]], State], longest_step: float
) -> Iterator[tuple[float, State, list[float]]]:
    """Yield time, state and controls after every step, from the plan's first state."""
    names, times = list(plan['states']), plan['times']
    columns = list(plan['controls'].values())
    state = [plan['states'][name][0] for name in names]
    yield times[0], state, [column[0] for column in columns]
    spline = None
    if plan['interpolation'] == 'cubic':
        spline = CubicSpline(times, list(zip(*columns, strict=True)))
    for k in range(len(times) - 1):
        span = times[k + 1] - times[k]
        assert span > 0
        first, last = [c[k] for c in columns], [c[k + 1] for c in columns]
        between = _between(plan['interpolation'], first, last, span, spline, times[k])
        steps = math.ceil(span / longest_step)
        h = span / steps
        for i in range(steps):
            t = i * h
            u0, u1, u2 = between(t), between(t + h / 2), between(t + h)
            k1 = rates(state, u0)
            k2 = rates([x + h / 2 * d for x, d in zip(state, k1, strict=True)], u1)
            k3 = rates([x + h / 2 * d for x, d in zip(state, k2, strict=True)], u1)
            k4 = rates([x + h * d for x, d in zip(state, k3, strict=True)], u2)
            state = [
                x + h / 6 * (a + 2 * (b + c) + d)
                for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
            ]
            yield times[k] + t + h, state, u2


def _between(
    kind: str, first: list[float], last: list[float], span: float, spline: Any, start: float
) -> Controls:
    if kind == 'linear':
        return lambda t: [a + (b - a) * t / span for a, b in zip(first, last, strict=True)]
    assert kind in ('zero_order_hold', 'cubic')
    return (lambda t: spline(start + t).tolist()) if kind == 'cubic' else (lambda t: first)


def pendulum_faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with a plan of the pendulum; empty if nothing is."""
    p, faults = document['parameters'], []
    torque, angle = p['limits.torque'], p['limits.disk_angle']
    most_torque = most_angle = 0.0
    quickest = max(map(abs, document['states']['theta_dot']), default=0.0)
    step = min(5e-4, 5e-3 / max(quickest, 1e-3))  # many swings magnify errors
    for _, state, control in replayed(document, pendulum_rates(p), step):
        most_torque = max(most_torque, abs(control[0]))
        most_angle = max(most_angle, abs(state[1]))
    if not most_torque <= torque * (1 + RELATIVE):
        faults.append(f'torque {most_torque} of {torque}')
    if not most_angle <= angle + ANGLE * max(1.0, angle):
        faults.append(f'disk angle {most_angle} of {angle}')
    turns = p['goal.turns']
    if turns is None:
        turns = round(state[0] / math.tau)
    end = [state[0] - math.tau * turns, *state[1:]]
    for (name, allowed), error in zip(PENDULUM_END.items(), end, strict=True):
        if not abs(error) <= 1.001 * allowed:
            faults.append(f'{name} ends {error} from the goal')
        away = document['states'][name][0] - p[f'start.{name}']
        if not abs(away) <= 1.001 * allowed:
            faults.append(f'{name} begins {away} elsewhere')
    return faults


def formation_faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with a plan of robots; empty if nothing is."""
    p, faults = document['parameters'], list[str]()
    names = p['robots']
    if list(document['robots']) != names:
        return [f'the robots are {list(document["robots"])}']
    last = max(plan['times'][-1] for plan in document['robots'].values())
    paths = {}
    for name in names:
        path, found = _robot_faults(name, document['robots'][name], p)
        faults += found
        paths[name] = _on_grid(path, last)
    for i, one in enumerate(names):
        for other in names[:i]:
            nearest = min(
                math.hypot(a[0] - b[0], a[1] - b[1])
                for a, b in zip(paths[one], paths[other], strict=True)
            )
            if not nearest >= p['arena.minimum_separation'] - DISTANCE:
                faults.append(f'{one} and {other} come within {nearest} m')
    return faults


def _robot_faults(
    name: str, plan: dict[str, Any], p: dict[str, Any]
) -> tuple[list[tuple[float, State]], list[str]]:
    faults, path = [], []
    half = p['arena.minimum_separation'] / 2
    thrust, rate, torque = (p[f'limits.{k}'] for k in ('thrust', 'thruster_rate', 'torque'))
    flat = p['arena.obstacles']
    zones = list(zip(flat[::3], flat[1::3], flat[2::3], strict=True))
    controls, distances = [0.0], [0.0]  # the largest excess
    for time, state, (f, d, t) in replayed(plan, robot_rates(p), 5e-3):
        x, y = state[:2]
        path.append((time, state))
        controls += [f / thrust - 1, -f / thrust, abs(d) / rate - 1, abs(t) / torque - 1]
        distances += [half - side for side in (x, y, p['arena.length'] - x, p['arena.width'] - y)]
        distances += [half + r - math.hypot(x - zx, y - zy) for zx, zy, r in zones]
    for what, excess, allowed in (
        ('actuators', max(controls), RELATIVE),
        ('walls or zones', max(distances), DISTANCE),
    ):
        if not excess <= allowed:
            faults.append(f'{name}: {what} by {excess}')
    goal = _goal(name, p)
    for k, (axis, allowed) in enumerate(ROBOT_END.items()):
        away = state[k] - goal[k]
        away = math.remainder(away, math.tau) if axis == 'yaw' else away
        if not abs(away) <= 1.001 * allowed:
            faults.append(f'{name}: {axis} ends {away} from the goal')
        away = plan['states'][axis][0] - p[f'{name}.start.{axis}']
        if not abs(away) <= ROBOT_START:
            faults.append(f'{name}: {axis} begins {away} elsewhere')
    return path, faults


def _goal(name: str, p: dict[str, Any]) -> State:
    x, y, turn = p['formation.anchor']
    dx, dy, dyaw = p[f'formation.{name}']
    c, s = math.cos(turn), math.sin(turn)
    return [x + c * dx - s * dy, y + s * dx + c * dy, 0.0, 0.0, turn + dyaw, 0.0]


def _on_grid(path: list[tuple[float, State]], last: float) -> list[State]:
    """Places at common instants 5 ms apart, linear between the steps; parked after the end."""
    times = np.array([time for time, _ in path])
    places = np.array([state[:2] for _, state in path])
    grid = np.linspace(0.0, last, math.ceil(last / 5e-3) + 1)
    return np.stack([np.interp(grid, times, places[:, k]) for k in (0, 1)], axis=1).tolist()


FAULTS = {'pendulum_swing_up': pendulum_faults, 'robot_formation': formation_faults}


def faults(document: dict[str, Any]) -> list[str]:
    """Return what is wrong with a plan as `tdm plan` writes it."""
    return FAULTS[document['problem']](document)


def pendulum_points(plant: Any, theta: Any, psi: Any) -> tuple[Any, Any]:
    """
    Positions of the pendulum's pivot and tip, (..., 3) m, about the disk's centre, z up.

    theta turns the rod, twice as long as its centre of mass is far, towards +y of the disk.
    """
    theta, psi = np.broadcast_arrays(theta, psi)
    zero = np.zeros_like(psi)
    radial = np.stack([np.cos(psi), np.sin(psi), zero], axis=-1)
    tangent = np.stack([-np.sin(psi), np.cos(psi), zero], axis=-1)
    up = np.stack([zero, zero, zero + 1.0], axis=-1)
    pivot = plant.arm_length * radial
    rod = np.sin(theta)[..., None] * tangent + np.cos(theta)[..., None] * up
    return pivot, pivot + 2.0 * plant.com_distance * rod

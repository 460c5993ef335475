# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The pendulum's scheme (9)-(16) of Yakimenko (2006), as printed and mended, measured.

The scheme prescribes both theta(tau) and T(tau). But the torque and the initial state already
determine the motion: what theta(tau) prescribes is only where the nodes lie. Three forms of it:

- `printed`: (11) as it stands, without the speed omega_(j-1) of the node before;
- `completed`: with it;
- `mended`: the state is E = theta.^2, dE/dtheta = 2 theta.., by Heun's method with nodes at the
  switches of the torque, so that rest and slow motion are no singularities.

All three need theta to be monotone. Minimum-time swing-ups are not: they swing back and forth
before they are up, and every reversal is a point where theta. vanishes though P' does not.

Run it: ``python docs/paper/pendulum_scheme.py``.
"""

from __future__ import annotations

from collections.abc import Callable
import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from tdm_planner.direct_method import PolynomialReference
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]
PLANT = RotaryPendulum()
TORQUE = 0.09
START, GOAL = np.pi, 0.0


class End(NamedTuple):
    """Where a scheme arrives: time, psi, signed theta.^2 and psi. at the last node; switches."""

    time: float
    psi: float
    energy: float
    psi_dot: float
    switch_times: Array

    @property
    def theta_dot(self) -> float:
        """Angular velocity on arrival, towards smaller angles."""
        return -float(np.sqrt(max(self.energy, 0.0)))


def torque_at(theta: float, switches: Array) -> float:
    """Bang-bang torque over the angle, first so that theta falls; `switches` are angles."""
    return -TORQUE if np.count_nonzero(switches > theta) % 2 == 0 else TORQUE


def nodes(count: int, switches: Array) -> Array:
    """Angles at `count` equidistant nodes of tau and, added, at the switches.

    The reference function begins at rest with P'' = -1: where P'' vanishes too, no time passes
    in the first step of any of the schemes, or it passes at the wrong rate.
    """
    reference = PolynomialReference({0: START, 1: 0.0, 2: -1.0}, {0: GOAL, 1: 0.0, 2: 1.0}, 3.0)
    theta = reference(np.linspace(0.0, reference.tau_f, count))
    assert (np.diff(theta) < 0).all()
    return np.sort(np.concatenate([theta, switches]))[::-1]


def rates(theta: float, theta_dot: float, psi_dot: float, torque: float) -> tuple[float, float]:
    """Theta.. and psi.. of the plant."""
    sine, cosine = float(np.sin(theta)), float(np.cos(theta))
    return PLANT.accelerations(sine, cosine, theta_dot, psi_dot, torque)


def printed(count: int, switches: Array, completed: bool = False) -> End:
    """(11)-(15), Euler steps over the virtual arc; `completed` adds omega_(j-1) to (11)."""
    reference = PolynomialReference({0: START, 1: 0.0, 2: -1.0}, {0: GOAL, 1: 0.0, 2: 1.0}, 3.0)
    tau = np.linspace(0.0, reference.tau_f, count)
    theta = reference(tau)
    omega, psi, psi_dot, time, speed_factor = 0.0, 0.0, 0.0, 0.0, 1.0
    step = tau[1]
    for j in range(1, count):
        torque = torque_at(0.5 * (theta[j] + theta[j - 1]), switches)
        forward, sideways = rates(theta[j - 1], omega, psi_dot, torque)
        new = forward / speed_factor * step + (omega if completed else 0.0)  # (11)
        elapsed = 2.0 * (theta[j] - theta[j - 1]) / (new + omega)  # (12)
        speed_factor = step / elapsed  # (13)
        time += elapsed  # (14)
        psi, psi_dot, omega = psi + psi_dot * elapsed, psi_dot + sideways * elapsed, new  # (15)
        if not np.isfinite(time) or elapsed <= 0.0:
            return End(np.nan, np.nan, np.nan, np.nan, np.zeros(0))
    return End(time, psi, omega**2, psi_dot, np.zeros(0))


def mended(count: int, switches: Array, floor: float = 1e-5) -> End:
    """The energy form by Heun's method; speeds are at least `floor` w0, the energy is not cut."""
    theta = nodes(count, switches)
    least = (floor * PLANT.natural_frequency) ** 2
    energy, psi, psi_dot, time = 0.0, 0.0, 0.0, 0.0
    passed = {}
    for here, there in itertools.pairwise(theta):
        if here == there:
            continue
        torque = torque_at(0.5 * (here + there), switches)
        speed = np.sqrt(max(energy, least))
        forward, sideways = rates(here, -speed, psi_dot, torque)
        ahead = energy + 2.0 * forward * (there - here)
        elapsed = 2.0 * (here - there) / (speed + np.sqrt(max(ahead, least)))
        later = rates(there, -np.sqrt(max(ahead, least)), psi_dot + sideways * elapsed, torque)
        energy += (forward + later[0]) * (there - here)
        elapsed = 2.0 * (here - there) / (speed + np.sqrt(max(energy, least)))
        before = psi_dot
        psi_dot += 0.5 * (sideways + later[1]) * elapsed
        psi += 0.5 * (before + psi_dot) * elapsed
        time += elapsed
        passed[there] = time
    times = np.array([passed[angle] for angle in sorted(switches)[::-1] if angle in passed])
    return End(time, psi, energy, psi_dot, times)


def truth(switches: Array) -> End:
    """The plant itself, integrated to where theta reaches the goal."""

    def motion(t: float, x: Array) -> Array:
        return PLANT.derivative(x, np.array([torque]))

    def reaches(angle: float) -> Callable[[float, Array], float]:
        def event(t: float, x: Array) -> float:
            return float(x[0]) - angle

        event.terminal = True  # type: ignore[attr-defined]
        return event

    x, time, times = np.array([START, 0.0, 0.0, 0.0]), 0.0, []
    for k, angle in enumerate([*sorted(switches)[::-1], GOAL]):
        torque = -TORQUE if k % 2 == 0 else TORQUE
        piece = solve_ivp(
            motion, (time, time + 2.0), x, 'DOP853', events=reaches(angle), rtol=1e-11, atol=1e-12
        )
        x, time = piece.y[:, -1], float(piece.t[-1])
        times.append(time)
    return End(time, x[1], x[2] ** 2, x[3], np.array(times[:-1]))


def residual(switches: Array, count: int, floor: float, home: bool = False) -> Array:
    """What must vanish on arrival: theta.^2 (signed) and psi., scaled; psi as well if `home`."""
    w0 = PLANT.natural_frequency
    with np.errstate(all='ignore'):
        end = mended(count, np.clip(switches, GOAL + 1e-6, START - 1e-6), floor)
        values = np.array([end.energy / w0**2, end.psi_dot / w0, end.psi][: 3 if home else 2])
    return np.clip(np.nan_to_num(values, nan=1e3), -1e3, 1e3)


def transfer(guess: Array, count: int = 60, home: bool = False) -> tuple[Array, float]:
    """Search for switches (k,) that bring all to rest with the pendulum upright; their residual.

    The disk may come to rest anywhere unless it is to be `home`. The floor of the speed is lowered
    step by step (continuation), else hardly a start succeeds.
    """
    switches = guess
    for floor in (1.0, 0.1, 1e-2, 1e-3, 1e-5):
        found = least_squares(residual, switches, args=(count, floor, home), max_nfev=25)
        switches = found.x
    return np.sort(np.clip(switches, GOAL, START))[::-1], float(np.abs(found.fun).max())


def transfers(starts: int, switches: int, home: bool) -> list[tuple[Array, float]]:
    """Search from random starts; switches and residual of each, the best first."""
    rng = np.random.default_rng(0)
    guesses = [np.sort(rng.uniform(GOAL, START, switches))[::-1] for _ in range(starts)]
    return sorted((transfer(guess, home=home) for guess in guesses), key=lambda found: found[1])


def landing_error(switches: Array, count: int) -> float:
    """Distance from upright [rad] of the plant under the scheme's switching times."""
    end = mended(count, switches)
    x = np.array([START, 0.0, 0.0, 0.0])
    edges = [0.0, *end.switch_times, end.time]
    for k, (first, last) in enumerate(itertools.pairwise(edges)):
        torque = np.array([-TORQUE if k % 2 == 0 else TORQUE])
        piece = solve_ivp(
            lambda t, x, u=torque: PLANT.derivative(x, u),
            (first, last),
            x,
            'DOP853',
            rtol=1e-10,
            atol=1e-12,
        )
        x = piece.y[:, -1]
    return float(abs(x[0] - GOAL))


if __name__ == '__main__':
    switches = np.array([1.2])
    right = truth(switches)
    print(f'one switch at {switches[0]} rad: upright passed after {right.time:.5f} s')
    print('error of theta. on arrival, and of the time:')
    print('nodes       printed            completed            mended')
    for count in (26, 51, 101, 201, 401, 801):
        ends = [printed(count, switches), printed(count, switches, True), mended(count, switches)]
        errors = [
            f'{abs(e.theta_dot / right.theta_dot - 1):8.1e} {abs(e.time / right.time - 1):8.1e}'
            for e in ends
        ]
        print(f'{count:5d}   ' + '   '.join(errors))
    for count, home in ((2, False), (4, True)):
        found = transfers(20, count, home)
        solved = sum(miss < 1e-6 for _, miss in found)
        print(
            f'{count} switches, disk at rest {"at home" if home else "anywhere"}: {solved} of '
            f'{len(found)} random starts solved, smallest residual {found[0][1]:.1e}'
        )
        if solved:
            angles = found[0][0]
            print(f'    lands {landing_error(angles, 60):.1e} rad from upright')

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The pendulum's scheme (9)-(16) of Yakimenko (2006), as printed and mended, measured.

The scheme prescribes both theta(tau) and T(tau). But the torque and the initial state already
determine the motion: what theta(tau) prescribes is only where the nodes lie. Three forms of it:

- `printed`: (11) as it stands, without the speed omega_(j-1) of the node before;
- `completed`: with it;
- `mended`: see (`virtual_arc_program`):
  the state is E = theta.^2, dE/dtheta = 2 theta.., by Heun's method with nodes at the switches of
  the torque, so that rest is no singularity.

All three need theta to be monotone, and most swing-ups are not. `momentum_needed` says why.

Run it: ``python docs/paper/pendulum_scheme.py`` (a minute).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import BPoly
from scipy.optimize import brentq
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.exceptions import Infeasible
from tdm_planner.plants.rotary_pendulum import accelerations, RotaryPendulum
from tdm_planner.problems import PendulumLimits, PendulumStart, PendulumSwingUp, Solution
from virtual_arc_method import VirtualArcMethod
from virtual_arc_program import reference_shape, VirtualArcProgram

Array = NDArray[np.float64]
PLANT = RotaryPendulum()
TORQUE = 0.09
START, GOAL = np.pi, 0.0
DEADLINE = 2.0  # s for every plan: on a machine many times slower some would be missed


class End(NamedTuple):
    """Where a scheme arrives: time, psi, signed theta.^2 and psi. at the last node."""

    time: float
    psi: float
    energy: float
    psi_dot: float

    @property
    def theta_dot(self) -> float:
        """Angular velocity on arrival, towards smaller angles."""
        return -float(np.sqrt(max(self.energy, 0.0)))


def torque_at(theta: float, switches: Array) -> float:
    """Bang-bang torque over the angle, first so that theta falls; `switches` are angles."""
    return -TORQUE if np.count_nonzero(switches > theta) % 2 == 0 else TORQUE


def rates(theta: float, theta_dot: float, psi_dot: float, torque: float) -> tuple[float, float]:
    """Theta.. and psi.. of the plant."""
    return accelerations(PLANT.coefficients, theta, theta_dot, psi_dot, torque)


def printed(count: int, switches: Array, completed: bool = False) -> End:
    """
    (11)-(15), Euler steps over the virtual arc; `completed` adds omega_(j-1) to (11).

    The reference function begins at rest with P'' = -1: where P'' vanishes too, no time passes
    in the first step, or it passes at the wrong rate.
    """
    tau = np.linspace(0.0, 3.0, count)
    ends = (START, 0.0, -1.0), (GOAL, 0.0, 1.0)
    theta = BPoly.from_derivatives([0.0, 3.0], ends)(tau)
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
            return End(np.nan, np.nan, np.nan, np.nan)
    return End(time, psi, omega**2, psi_dot)


def mended(count: int, switch: float) -> End:
    """Return what the mended scheme makes of one switch, with `count` nodes or so."""
    task = problem(START, TORQUE).task
    program = VirtualArcProgram(task, TORQUE * np.array([-1.0, 1.0]), 0, count // 2)
    share = (START - switch) / (START - GOAL)
    tau = brentq(lambda t: reference_shape(np.array(t), 0.0) - share, 0.0, 1.0, xtol=1e-14)
    energy, psi, psi_dot, time = program.along(np.array([[tau]]), to_rest=False)[0, -1]
    return End(time, psi, energy, psi_dot)


def truth(switches: Array) -> End:
    """Return the plant itself, integrated to where theta reaches the goal."""

    def motion(t: float, x: Array) -> Array:
        return PLANT.derivative(x, np.array([torque]))

    def reaches(angle: float) -> Callable[[float, Array], float]:
        def event(t: float, x: Array) -> float:
            return float(x[0]) - angle

        event.terminal = True  # type: ignore[attr-defined]
        return event

    x, time = np.array([START, 0.0, 0.0, 0.0]), 0.0
    for k, angle in enumerate([*sorted(switches)[::-1], GOAL]):
        torque = -TORQUE if k % 2 == 0 else TORQUE
        piece = solve_ivp(
            motion, (time, time + 2.0), x, 'DOP853', events=reaches(angle), rtol=1e-11, atol=1e-12
        )
        x, time = piece.y[:, -1], float(piece.t[-1])
    return End(time, x[1], x[2] ** 2, x[3])


def problem(theta: float, torque: float, method: str = 'virtual_arc') -> PendulumSwingUp:
    """From rest at an angle, with all the torque."""
    return PendulumSwingUp(
        limits=PendulumLimits(torque=torque),
        torque_reserve=0.0,
        start=PendulumStart(theta=theta),
        method=method,
    )


def along_arc(made: PendulumSwingUp) -> Solution:
    """Plan by the mended scheme."""
    budget, rng = Budget(DEADLINE), np.random.default_rng(0)
    return VirtualArcMethod(made.task, budget, rng, made.switching_arcs, 1e-8).run()


def transfers(angles: Array, torques: Array) -> Array:
    """Return the times of transfers from rest over those of method switching, or NaN."""
    ratios = np.full((torques.size, angles.size), np.nan)
    for i, j in np.ndindex(ratios.shape):
        try:
            found = along_arc(problem(angles[j], torques[i]))
        except Infeasible:
            continue
        quickest = problem(angles[j], torques[i], 'switching').solve(deadline=DEADLINE)
        ratios[i, j] = found.cost / quickest.cost
    return ratios


def share_solved(torque: float, starts: int) -> tuple[float, float]:
    """
    Shares of random states from which virtual_arc finds a plan, and of monotone quickest ones.

    Any angle, psi within 1 rad, rates within 5 rad/s.
    """
    rng = np.random.default_rng(0)
    solved, monotone = 0, 0
    for state in rng.uniform(-1.0, 1.0, (starts, 4)) * [np.pi, 1.0, 5.0, 5.0]:
        made = replace(problem(0.0, torque), start=PendulumStart(*map(float, state)))
        try:
            along_arc(made)
            solved += 1
        except Infeasible:
            pass
        quickest = replace(made, method='switching').solve(deadline=DEADLINE).trajectory
        slopes = np.diff(quickest.state('theta'))
        monotone += bool((slopes > -1e-6).all() or (slopes < 1e-6).all())
    return solved / starts, monotone / starts


def landing_errors(theta: float, torque: float, counts: tuple[int, ...]) -> dict[int, float]:
    """
    Distance from upright [rad] of the plant under the switching times of the scheme alone.

    By the number of nodes, for the transfer from rest at `theta`; nothing is corrected afterwards.
    """
    task = problem(theta, torque).task
    search = VirtualArcMethod(task, Budget(10.0), np.random.default_rng(0), 4, 1e-9)
    candidate = search.candidates()[0]
    torques, turns, xi = candidate.program.torques, candidate.program.turns, candidate.point
    errors = {}
    for count in counts:
        program = VirtualArcProgram(task, torques, turns, count // torques.size)
        options = TrustRegionOptions(penalties=(30.0, 30.0), feasibility=(1e-9, 1e-9), radius=0.05)
        xi = minimise(program, xi, options).point.xi
        x = task.start
        for duration, torque in zip(program.durations(xi), torques, strict=True):
            held = np.array([torque])
            x = solve_ivp(
                lambda t, x, u=held: PLANT.derivative(x, u),
                (0.0, duration),
                x,
                'DOP853',
                rtol=1e-11,
                atol=1e-12,
            ).y[:, -1]
        errors[count] = float(abs(x[0] - 2 * np.pi * turns))
    return errors


def momentum_needed(theta: Array, theta_dot: Array, psi_dot: Array) -> Array:
    """
    Rate of the momentum p = A theta. + B psi. that gravity and rotation give, over m g l.

    The torque does not act on p. From rest to rest p begins and ends at zero, so that
    sin(theta) (m g l + c cos(theta) psi.^2 - m l r theta. psi.) must be zero on average: theta
    must be on either side of upright, or theta. psi. beyond g/r for long enough, or the pendulum
    below the horizontal with psi. large. Falling from theta < pi/2 straight to upright is none of
    these: theta. < 0 and p >= 0 mean psi. > 0, and the rate stays positive.
    """
    k = PLANT.coefficients
    rotation = k.coupling * np.cos(theta) * psi_dot**2 - k.arm * theta_dot * psi_dot
    return np.asarray(np.sin(theta) * (1.0 + rotation / k.gravity))


if __name__ == '__main__':
    switches = np.array([1.2])
    right = truth(switches)
    print(f'one switch at {switches[0]} rad: upright passed after {right.time:.5f} s')
    print('error of theta. on arrival, and of the time:')
    print('nodes       printed            completed            mended')
    for count in (26, 51, 101, 201, 401, 801):
        ends = [printed(count, switches), printed(count, switches, True), mended(count, 1.2)]
        errors = [
            f'{abs(e.theta_dot / right.theta_dot - 1):8.1e} {abs(e.time / right.time - 1):8.1e}'
            for e in ends
        ]
        print(f'{count:5d}   ' + '   '.join(errors))
    print('a transfer to rest from .4 rad at .063 N m: nodes, rad from upright in the plant')
    for count, error in landing_errors(0.4, 0.063, (20, 40, 80, 160, 320, 640)).items():
        print(f'{count:5d}   {error:.1e}')
    angles, torques = np.array([0.2, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8, np.pi]), (0.02, 0.04, 0.09)
    print(f'from rest, no torque in reserve, {DEADLINE:g} s for every plan:')
    print('t_f over that of method switching, - where no transfer was found')
    print('N m    ' + ' '.join(f'{angle:5.2f}' for angle in angles) + '  rad')
    for torque, row in zip(torques, transfers(angles, np.array(torques)), strict=True):
        shown = ['    -' if np.isnan(ratio) else f'{ratio:5.2f}' for ratio in row]
        print(f'{torque:5.3f}  ' + ' '.join(shown))
    for torque in torques:
        solved, monotone = share_solved(torque, 40)
        print(
            f'random states, {torque} N m: {solved:.0%} solved along a virtual arc; theta is '
            f'monotone in {monotone:.0%} of the plans of method switching'
        )

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Evidence for the misprints in the pendulum's equations of motion (7) of Yakimenko (2006).

Each is put, alone, into the right equations, and the energy balance is drawn up over 2 s of motion
under a constant torque: what the energy gains must be the work of the torque. In the right
equations it is, to the accuracy of the integration.

Run it: ``python docs/paper/misprints.py``.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]

MISPRINTS = {
    'm l for m l^2': 'I_z^p + m l for I_z^p + m l^2 in (7), five times',
    'sin(theta)': 'sin(theta) for sin(2 theta) in the first brackets of f1 and f2',
    'factor of f1': 'no factor I_y^d + m r^2 + ... on the second bracket of f1',
    'I_y^p in h1': "I_y^p for I_y^d in h1's denominator",
    'sign in f2': '+ m l r theta.^2 sin(theta) for - in the first bracket of f2',
}


def accelerations(
    plant: RotaryPendulum, state: Array, torque: float, wrong: Collection[str]
) -> tuple[float, float]:
    """Return theta.. and psi.. as in (7), with the misprints named in `wrong`."""
    theta, _, theta_dot, psi_dot = state
    inertia, k = plant.inertia, plant.coefficients
    sine, cosine, double = np.sin(theta), np.cos(theta), np.sin(2 * theta)
    moment = plant.mass * plant.com_distance
    a = inertia.z + (moment if 'm l for m l^2' in wrong else moment * plant.com_distance)
    b = k.arm * cosine
    j = k.disk + k.disk_sine * sine**2 + k.disk_cosine * cosine**2
    cross = k.coupling * psi_dot * theta_dot * (sine if 'sin(theta)' in wrong else double)
    centrifugal = k.arm * theta_dot**2 * sine
    second = 0.5 * psi_dot**2 * k.coupling * double + k.gravity * sine
    determinant = a * j - b**2
    f1 = b * (cross - centrifugal) + second * (1.0 if 'factor of f1' in wrong else j)
    sign = 1.0 if 'sign in f2' in wrong else -1.0
    f2 = -a * (cross + sign * centrifugal) - b * second
    in_h1 = determinant
    if 'I_y^p in h1' in wrong:
        in_h1 = a * (j + inertia.y - inertia.disk) - b**2
    h1, h2 = -b / in_h1, a / in_h1
    return f1 / determinant + h1 * torque, f2 / determinant + h2 * torque


def energy_error(wrong: Collection[str], torque: float = 0.005) -> float:
    """
    Largest error of the energy balance over 2 s, in units of m g l.

    A motion that exceeds 300 rad/s is followed no further.
    """
    plant = RotaryPendulum()

    def rates(t: float, x: Array) -> list[float]:
        return [x[2], x[3], *accelerations(plant, x, torque, wrong)]

    def runs_away(t: float, x: Array) -> float:
        return 300.0 - float(np.abs(x[2:]).max())

    runs_away.terminal = True  # type: ignore[attr-defined]
    start = np.array([2.5, 0.0, 1.0, 2.0])
    motion = solve_ivp(
        rates, (0.0, 2.0), start, method='DOP853', events=runs_away, rtol=1e-11, atol=1e-12
    )
    states = motion.y.T
    balance = plant.energy(states) - torque * states[:, 1]
    return float(np.abs(balance - balance[0]).max() / plant.coefficients.gravity)


if __name__ == '__main__':
    print('energy balance over 2 s [m g l]')
    print(f'{energy_error(()):12.2e}    the right equations')
    for name, words in MISPRINTS.items():
        print(f'{energy_error((name,)):12.2e}    {words}')
    print(f'{energy_error(tuple(MISPRINTS)):12.2e}    all of them: (7) as printed')

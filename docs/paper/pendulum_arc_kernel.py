# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled recursion of the rotary pendulum along a prescribed angle, see `advance_along`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants import rotary_pendulum as stated
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.rotary_pendulum import Coefficients

# Real, or complex where derivatives are taken by complex step.
Values = NDArray[Any]

for part in (stated.mechanics, stated.accelerations_by):
    inlined(part)
accelerations = inlined(stated.accelerations)


@compiled
def _speed(energy: Any, least: float) -> Any:
    """Root of the energy's size, smooth, and at least that of `least`."""
    return np.sqrt(np.sqrt(energy * energy + least * least))


@compiled
def advance_along(
    k: Coefficients,
    theta: Values,
    from_rest: bool,
    to_rest: bool,
    torques: Values,
    least: float,
    states: Values,
) -> None:
    """
    Fill `states` (B, N, 4), (E, psi, psi', t), at nodes of the angle `theta` (B, N).

    E = theta'^2 changes by 2 theta'' d theta, the rest by time, which passes as (12) of Yakimenko
    (2006) has it, dt = 2 d theta / (theta'_j + theta'_(j-1)); Heun's method, of second order in
    the virtual arc if theta is smooth in it and its derivative vanishes where the pendulum rests.
    `states[:, 0]` is given; `torques` (N - 1,) [N m] act between the nodes.

    The speed is the root of the size of E, at least of `least`: a negative E, an angle beyond
    reach, is left for the caller to make positive. At the first node if the motion starts
    `from_rest`, and at the last if it is to end so, the speed is zero: time then depends smoothly
    on a final E that is not zero yet.
    """
    last = theta.shape[1] - 1
    for b in range(theta.shape[0]):
        energy, psi, psi_dot, time = states[b, 0]
        speed = 0.0 * energy
        if not from_rest:
            speed = _speed(energy, least)
        for node in range(1, last + 1):
            here, there, torque = theta[b, node - 1], theta[b, node], torques[node - 1]
            change = there - here
            way = -1.0 if change.real < 0.0 else 1.0
            forward, sideways = accelerations(k, here, way * speed, psi_dot, torque)
            ahead = 0.0 * energy
            if node < last or not to_rest:
                ahead = _speed(energy + 2.0 * forward * change, least)
            elapsed = 2.0 * way * change / (speed + ahead)
            forward_there, sideways_there = accelerations(
                k, there, way * ahead, psi_dot + sideways * elapsed, torque
            )
            energy = energy + (forward + forward_there) * change
            if node < last or not to_rest:
                ahead = _speed(energy, least)
                elapsed = 2.0 * way * change / (speed + ahead)
            before = psi_dot
            psi_dot = psi_dot + 0.5 * (sideways + sideways_there) * elapsed
            psi = psi + 0.5 * (before + psi_dot) * elapsed
            time = time + elapsed
            speed = ahead
            states[b, node, 0] = energy
            states[b, node, 1] = psi
            states[b, node, 2] = psi_dot
            states[b, node, 3] = time

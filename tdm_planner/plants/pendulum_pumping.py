# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Swings that pump the rotary pendulum up by a law of bang-bang torque, compiled.

With the momentum L = J psi' + B theta', the place Q = psi + G(theta), G = int B / J d theta, and
E = (A - B^2/J) theta'^2 / 2 + m g l cos(theta) the motion reads

    L' = T,  Q' = L / J,  E' = -T (B/J) theta' + L^2 J_theta theta' / (2 J^2):

the sign of -theta' cos(theta) pumps, and the disk is a double integrator in (Q, L) that has to
come back to zero. The law adds both up, brakes the disk before its limit, and has a few numbers
that are drawn at random: of many variants some come near upright at rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.pendulum_kernels import (
    quick_accelerations,
    runge_kutta,
    sine_and_cosine,
)
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

# Times the share of the pendulum's inertia that is left: a share of the step; and the least.
_INERTIA, _LEAST = 1.5, 0.06
_MOST_STEPS = 400_000  # of a motion: a light disk may cross its range in no time
_SHARE_OF_DISK = 0.12  # of the time in which the torque alone crosses the disk's range: a step
_DWELL = 0.15  # of 1/w0, between two switches that the disk's limit does not ask for
_AWAY = 4.0  # sum of squares that a motion must have seen before it may be near
NEAR = 1.5  # sum of squares from which it may be landed
_BEYOND = 1.2  # times the disk's limit: a motion that goes there ends
_PUMPS, _LAW = 1, 2  # stages: the first arc, its reversal is awaited, as the law has it


class Pumping(NamedTuple):
    """
    What all variants share.

    `torque` [N m], `psi_max` [rad], `w0` [rad/s], `turn` the goal's number of turns, NaN for the
    nearest; a motion lasts at most `longest` / w0, integrated in steps of at most `step` [s],
    shorter where the disk turns with the pendulum.
    """

    torque: float
    psi_max: float
    w0: float
    turn: float
    longest: float
    step: float


class Laws(NamedTuple):
    """
    Numbers (n,) of the variants.

    `first`: sign of the first arc; `share` of the torque that is used; `on_place`, `on_momentum`:
    gains on Q and L; `band`: of the energy, in m g l, in which pumping fades; `brake`: share of
    the disk's limit before which it stands; `lead` of the switches [rad of the swing]; `hold`:
    duration of the first arc [1/w0], 0 for what the law says; `weight` [1/w0] of the root of the
    distance from the goal beside the time, which decides where a motion is cut.
    """

    first: Array
    share: Array
    on_place: Array
    on_momentum: Array
    band: Array
    brake: Array
    lead: Array
    hold: Array
    weight: Array


@compiled
def slowness(k: Coefficients) -> float:
    """Frequency of small swings with the disk held, over that with the disk free: at most 1."""
    return math.sqrt(1.0 - k.arm * k.arm / (k.pendulum * (k.disk + k.disk_cosine)))


@compiled
def _wanted(
    k: Coefficients,
    p: Pumping,
    law: Laws,
    n: int,
    theta: float,
    psi: float,
    w: float,
    v: float,
    held: float,
) -> tuple[float, bool, float]:
    """
    Torque by the law, `held` where nothing asks for another; whether the disk's limit asks for it.

    Last the share of the pendulum's inertia that the disk, turning with it, leaves.
    """
    sine, cosine = sine_and_cosine(theta)
    j0, b = k.disk + k.disk_cosine, k.arm * cosine
    j = k.disk + k.disk_sine * sine * sine + k.disk_cosine * cosine * cosine
    free = k.pendulum / (k.pendulum * j0 - k.arm * k.arm)  # psi'' by torque, upright or hanging
    inertia = 1.0 - b * b / (k.pendulum * j)
    if psi * v > 0.0:
        stop = -p.torque if v > 0.0 else p.torque
        braked = quick_accelerations(k, theta, w, v, stop)[1]
        slower = max(-braked if v > 0.0 else braked, 0.15 * p.torque * free)
        if abs(psi) + 0.5 * v * v / slower > law.brake[n] * p.psi_max:
            return stop, True, inertia
    level = law.share[n] * p.torque
    unit = level * free / (p.w0 * p.w0)  # of Q
    bend = math.sqrt(max((k.disk_sine - k.disk_cosine) / j0, 1e-9))
    place = psi + k.arm / (j0 * bend) * math.atan(bend * sine)
    momentum = j * v + b * w
    energy = 0.5 * k.pendulum * inertia * w * w / k.gravity + cosine
    pumping = -cosine * (w / p.w0 + law.lead[n] * sine)
    pumping /= math.sqrt(max(2.0 * (energy + 1.0), 1e-4))
    pumping *= max(-1.0, min(1.0, (1.0 - energy) / law.band[n]))
    centring = law.on_place[n] * place + law.on_momentum[n] * momentum / (j0 * p.w0)
    balance = pumping - centring / unit
    if abs(balance) < 1e-12:
        return held, False, inertia
    return (level if balance > 0.0 else -level), False, inertia


@compiled
def _pumped(
    k: Coefficients,
    start: Array,
    p: Pumping,
    law: Laws,
    n: int,
    durations: Array,
    torques: Array,
) -> tuple[int, float]:
    """Follow one variant; how many arcs there are to where it comes nearest, and the distance."""
    w0, most = p.w0, durations.size
    level = law.share[n] * p.torque
    free = k.pendulum / (k.pendulum * (k.disk + k.disk_cosine) - k.arm * k.arm)
    crossing = math.sqrt(min(p.psi_max, 3.0) / (level * free))
    largest_step = min(p.step, _SHARE_OF_DISK * crossing)
    theta, psi, w, v = start[0], start[1], start[2], start[3]
    held, stage, hold = law.first[n] * level, 0, law.hold[n] * slowness(k) / w0
    if hold == 0.0:
        stage = _LAW
    away = n % 8 == 0  # the others may not stay near the top where they begin there
    arc, age, total = 0, 0.0, 0.0
    nearest, promise, since, arcs, last = np.inf, np.inf, 0.0, 0, 0.0
    for _ in range(_MOST_STEPS):
        if total >= p.longest / w0:
            break
        want, braking, inertia = _wanted(k, p, law, n, theta, psi, w, v, held)
        if stage == 0 and total >= hold:
            stage = _PUMPS
        if stage == _PUMPS and want * law.first[n] < 0.0:
            stage = _LAW
        if stage < _LAW and not braking:
            want = law.first[n] * level * (1.0 if stage == 0 else -1.0)
        if total == 0.0:
            held = want if braking else held
        elif want != held and (age >= _DWELL / w0 or braking or want * held > 0.0):
            if arc + 1 >= most:
                break
            durations[arc], torques[arc] = age, held
            arc, age, held = arc + 1, 0.0, want
        # Swings are quick where the disk takes most of the inertia; many of them magnify errors.
        h = min(largest_step, max(_INERTIA * inertia, _LEAST) * p.step)
        theta, psi, w, v = runge_kutta(k, theta, psi, w, v, held, h)
        age += h
        total += h
        if not (abs(psi) < _BEYOND * p.psi_max and abs(w) < 1e3 * w0):
            break
        turn = math.floor(theta / (2.0 * math.pi) + 0.5) if math.isnan(p.turn) else p.turn
        miss = theta - 2.0 * math.pi * turn
        distance = miss * miss + psi * psi + (w * w + v * v) / (w0 * w0)
        away = away or distance > _AWAY
        found = total * w0 + law.weight[n] * math.sqrt(distance)
        if away and distance < NEAR and found < promise:
            nearest, promise, since, arcs, last = distance, found, total, arc, age
            torques[arc] = held
        elif (total - since) * w0 > law.weight[n] * math.sqrt(nearest):
            break  # no later instant can promise more
    if nearest == np.inf:
        return 0, nearest
    durations[arcs] = last
    return arcs + 1, nearest


@compiled
def pump(
    k: Coefficients,
    start: Array,
    pumping: Pumping,
    laws: Laws,
    durations: Array,
    torques: Array,
    arcs: Integers,
    distances: Array,
) -> None:
    """
    Follow every variant from `start` (4,) to where it promises most.

    Filled are `durations` [s] and `torques` [N m] (n, K) of its arcs, their number `arcs` (n,), 0
    if it never comes near, and `distances` (n,), the sum of squares that shooting reduces.
    """
    for n in range(arcs.size):
        arcs[n], distances[n] = _pumped(k, start, pumping, laws, n, durations[n], torques[n])


def compile_pump(plant: RotaryPendulum) -> None:
    """Compile the kernel or load it from the disk."""
    pumping = Pumping(1.0, 1.0, 1.0, math.nan, 0.0, 1.0)
    laws = Laws(*np.ones((9, 1)))
    rows = np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1, np.intp), np.zeros(1)
    pump(plant.coefficients, np.zeros(4), pumping, laws, *rows)

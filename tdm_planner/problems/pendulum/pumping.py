# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Swings that pump the rotary pendulum up by a law of bang-bang torque, compiled.

With the momentum L = J psi' + B theta', the place Q = psi + G(theta), G = int B / J d theta, and
E = (A - B^2/J) theta'^2 / 2 + m g l cos(theta) the motion reads

    L' = T,  Q' = L / J,  E' = -T (B/J) theta' + L^2 J_theta theta' / (2 J^2):

the sign of -theta' cos(theta) pumps, and the disk is a double integrator in (Q, L) that has to
come back to zero. The law adds both up and brakes the disk before its limit. A disk that crosses
a narrow range quickly throws the pendulum out, by the last term: in some variants it goes to and
fro while theta' points outwards. A few numbers are drawn at random: of many variants some come
near upright at rest. The most promising are kept but for their last arcs, which shooting adjusts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Integers
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants.compilation import compiled, inlined, sine_and_cosine, sum_in_threads
from tdm_planner.plants.pendulum_kernels import (
    HELD,
    LANES,
    PSI,
    PSI_DOT,
    quick_accelerations,
    quick_time,
    STEP,
    step_lanes,
    THETA_DOT,
)
from tdm_planner.plants.rotary_pendulum import Coefficients
from tdm_planner.problems.pendulum.candidates import (
    Candidate,
    FEWEST_ARCS,
    shoot_upright,
    TAIL_STEPS,
    to_polish,
)
from tdm_planner.problems.pendulum.task import SwingUpTask

_MOST_STEPS = 400_000  # of a motion: a light disk may cross its range in no time
_STEP_SHARE, _SHARE_OF_DISK = 0.15, 0.12  # a step, of `quick_time` and of a crossing of the range
_NEVER, _SHAKEN = -2.0, 0.9  # energies, in m g l, below which the disk goes to and fro
_DWELL = 0.15  # of 1/w0, between two switches that the disk's limit does not ask for
_AWAY, _NEAR = 4.0, 1.5  # sums of squares that a motion must have seen first, and is landed from
_INSIDE = 0.995  # of the disk's limit; a motion ends beyond, it could not be landed
# Where rows of lanes begin in the flat array `x` (see pendulum_kernels), behind state, torque and
# step: what the law says, then what it is made of.
(
    _WANTED, _BRAKING, _DISTANCE, _LARGEST, _LEVEL, _ON_PLACE, _ON_MOMENTUM, _BAND, _BRAKE, _LEAD,
    _SHAKE, _ROWS,
) = range(6 * LANES, 18 * LANES, LANES)  # fmt: skip
_VARIANTS = 256  # simulated in a round
_BATCH = 2 * LANES  # variants to simulate, or tails to shoot, between checks of the time left
_USUAL, _MOST_VARIANTS = 4 * _VARIANTS, 6 * _VARIANTS  # undamped ones; all, damped ones included
# Longest time of a pump, in 1/w0: the work over the drive, within bounds.
_LONGEST_WORK, _LEAST_LONGEST, _MOST_LONGEST = 10.0, 400.0, 12000.0
# Promising variants to collect for every lane, until a share of the time; one is enough after it.
_SWINGS_A_LANE, _AT_LEISURE = 3, 0.2
# Variants whose tails are shot; arrivals that are enough; share of the time after which one is.
_LANDED, _ENOUGH, _ONE_DOES = 48, 5, 0.3
_WEIGHT, _WORK = 8.0, 2.5  # of the root of the distance: at least; over the drive
_MOST_WEIGHT, _RANK = 30.0, 1.5  # times that weight: at most, and where variants are compared
_TAIL, _TAIL_WORK = (14, 56), 1.8  # arcs varied: at least and at most; over the drive
_EVALUATION = 1500.0  # steps, that take as long as to compute the dynamics along one candidate
_EXTRA, _SHORT = 2, 0.1  # arcs put at the end, of so many 1/w0
_PUMPS, _LAW = 1, 2  # stages: the first arc, its reversal is awaited, as the law has it


class PumpingConstants(NamedTuple):
    """
    What all variants share.

    `torque` [N m], `psi_max` [rad], `w0` [rad/s], `turn` the goal's number of turns, NaN for the
    nearest; a motion lasts at most `longest` / w0.
    """

    torque: float
    psi_max: float
    w0: float
    turn: float
    longest: float


class PumpingLaws(NamedTuple):
    """
    Numbers (n,) of the variants.

    `first`: sign of the first arc; `share` of the torque that is used; `on_place`, `on_momentum`:
    gains on Q and L; `band`: of the energy [m g l] in which pumping fades; `brake`: share of the
    disk's limit before which it stands; `lead`: tangent of the phase by which it switches early;
    `hold`: duration of the first arc [1/w0], 0 for what the law says; `weight` [1/w0] of the root
    of the distance from the goal beside the time, by which a motion is cut; `shake`: energy
    [m g l] below which the disk goes to and fro while theta' points outwards.
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
    shake: Array


@compiled
def _steer(k: Coefficients, p: PumpingConstants, x: Array) -> None:
    """
    Fill in the torque by the law, whether the disk's limit asks for it, and the step.

    Where nothing asks for another torque it is the one held.
    """
    j0 = k.disk + k.disk_cosine
    free = k.pendulum / (k.pendulum * j0 - k.arm * k.arm)  # psi'' by torque, upright or hanging
    bend = math.sqrt(max((k.disk_sine - k.disk_cosine) / j0, 1e-9))
    weakest = 0.15 * p.torque * free
    for i in range(LANES):
        theta, psi, w, v = x[i], x[PSI + i], x[THETA_DOT + i], x[PSI_DOT + i]
        sine, cosine = sine_and_cosine(theta)
        b = k.arm * cosine
        j = k.disk + k.disk_sine * sine * sine + k.disk_cosine * cosine * cosine
        inertia = 1.0 - b * b / (k.pendulum * j)
        stop = -p.torque if v > 0.0 else p.torque
        braked = quick_accelerations(k, theta, w, v, stop)[1]
        slower = -braked if v > 0.0 else braked
        slower = slower if slower > weakest else weakest
        beyond = abs(psi) + 0.5 * v * v / slower - x[_BRAKE + i] * p.psi_max
        level = x[_LEVEL + i]
        energy = 0.5 * k.pendulum * inertia * w * w / k.gravity + cosine
        height = 2.0 * (energy + 1.0)
        fading = (1.0 - energy) / x[_BAND + i]
        fading = fading if fading < 1.0 else 1.0
        fading = fading if fading > -1.0 else -1.0
        pumping = -cosine * (w / p.w0 + x[_LEAD + i] * sine)
        pumping *= fading / math.sqrt(height if height > 1e-4 else 1e-4)
        place = psi + k.arm / (j0 * bend) * _arctangent(bend * sine)
        momentum = (j * v + b * w) / (j0 * p.w0)
        centring = x[_ON_PLACE + i] * place + x[_ON_MOMENTUM + i] * momentum
        balance = pumping - centring * p.w0 * p.w0 / (level * free)
        wanted = level if balance > 0.0 else -level
        shaken = sine * cosine * w >= 0.0 and energy < x[_SHAKE + i]
        wanted = x[HELD + i] if shaken or abs(balance) < 1e-12 else wanted
        braking = (beyond if beyond < 0.0 else 1.0) if psi * v > 0.0 else -1.0
        x[_BRAKING + i] = braking
        x[_WANTED + i] = stop if braking > 0.0 else wanted
        step = _STEP_SHARE * quick_time(k, theta, w, v)
        x[STEP + i] = step if step < x[_LARGEST + i] else x[_LARGEST + i]


@inlined
def _arctangent(x: float) -> float:
    """To 1e-5, without a branch (Abramowitz and Stegun 4.4.49)."""
    size = abs(x)
    y = 1.0 / size if size > 1.0 else size
    z = y * y
    y *= 0.999866 + z * (-0.3302995 + z * (0.180141 + z * (-0.085133 + z * 0.0208351)))
    y = 0.5 * math.pi - y if size > 1.0 else y
    return -y if x < 0.0 else y


@compiled
def _measure(p: PumpingConstants, inside: float, x: Array) -> None:
    """Sum of squares of the distance from the goal; infinite where a motion is to end."""
    for i in range(LANES):
        psi, w, v = x[PSI + i], x[THETA_DOT + i], x[PSI_DOT + i]
        turn = np.floor(x[i] / (2.0 * math.pi) + 0.5)
        turn = p.turn if p.turn == p.turn else turn
        miss = x[i] - 2.0 * math.pi * turn
        distance = miss * miss + psi * psi + (w * w + v * v) / (p.w0 * p.w0)
        distance = distance if abs(psi) <= inside else np.inf
        x[_DISTANCE + i] = distance if abs(w) < 1e3 * p.w0 else np.inf


@compiled
def simulate_variants(
    k: Coefficients,
    start: Array,
    pumping: PumpingConstants,
    laws: PumpingLaws,
    durations: Array,
    torques: Array,
    arcs: Integers,
    distances: Array,
) -> int:
    """
    Follow every variant, by itself, from `start` (4,) to where it promises most.

    Filled are `durations` [s] and `torques` [N m] (n, K) of its arcs, their number `arcs` (n,), 0
    if it never comes near, and `distances` (n,), the sum of squares that shooting reduces. Returns
    the number of steps taken.
    """
    p, w0, most = pumping, pumping.w0, durations.shape[1]
    free = k.pendulum / (k.pendulum * (k.disk + k.disk_cosine) - k.arm * k.arm)
    # Of small swings with the disk held, over that with the disk free: at most 1.
    slow = math.sqrt(1.0 - k.arm * k.arm / (k.pendulum * (k.disk + k.disk_cosine)))
    inside = max(_INSIDE * p.psi_max, 1.01 * abs(start[1]))
    x, lanes = np.zeros(_ROWS), np.full(LANES, -1, np.intp)
    stage, arc, taken = np.zeros(LANES, np.intp), np.zeros(LANES, np.intp), 0
    steps, away = np.zeros(LANES, np.intp), np.zeros(LANES, np.bool_)
    age, total, since, last = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    promise, done = np.empty(LANES), 0
    while True:
        for i in range(LANES):
            if lanes[i] < 0 and taken < arcs.size:
                n = taken
                taken, lanes[i] = taken + 1, n
                level = laws.share[n] * p.torque
                for m in range(4):
                    x[m * LANES + i] = start[m]
                x[HELD + i], x[_LEVEL + i] = laws.first[n] * level, level
                x[_ON_PLACE + i], x[_ON_MOMENTUM + i] = laws.on_place[n], laws.on_momentum[n]
                x[_BAND + i], x[_BRAKE + i] = laws.band[n], laws.brake[n]
                x[_LEAD + i], x[_SHAKE + i] = laws.lead[n], laws.shake[n]
                x[_LARGEST + i] = _SHARE_OF_DISK * math.sqrt(min(p.psi_max, 3.0) / (level * free))
                stage[i], arc[i], steps[i] = (_LAW if laws.hold[n] == 0.0 else 0), 0, 0
                away[i] = n % 8 == 0  # the others may not stay near the top where they begin there
                age[i] = total[i] = since[i] = last[i] = 0.0
                promise[i], arcs[n], distances[n] = np.inf, 0, np.inf
        if lanes.max() < 0:
            return done
        _steer(k, p, x)
        for i in range(LANES):
            n = lanes[i]
            if n < 0:
                continue
            want, held, braking = x[_WANTED + i], x[HELD + i], x[_BRAKING + i] > 0.0
            if stage[i] < _LAW:
                first = laws.first[n]
                if stage[i] == 0 and total[i] >= laws.hold[n] * slow / w0:
                    stage[i] = _PUMPS
                if stage[i] == _PUMPS and want * first < 0.0:
                    stage[i] = _LAW
                elif not braking:
                    want = first * x[_LEVEL + i] * (1.0 if stage[i] == 0 else -1.0)
            if total[i] == 0.0:
                x[HELD + i] = want if braking else held
            elif want != held and (age[i] >= _DWELL / w0 or braking or want * held > 0.0):
                durations[n, arc[i]], torques[n, arc[i]] = age[i], held
                arc[i], age[i], x[HELD + i] = arc[i] + 1, 0.0, want
            age[i] += x[STEP + i]
            total[i] += x[STEP + i]
            steps[i] += 1
        step_lanes(k, x)
        _measure(p, inside, x)
        for i in range(LANES):
            n = lanes[i]
            if n < 0:
                continue
            distance, weight = x[_DISTANCE + i], laws.weight[n]
            goes_on = distance < np.inf and arc[i] < most
            if goes_on:
                away[i] = away[i] or distance > _AWAY
                if away[i] and distance < _NEAR:
                    found = total[i] * w0 + weight * math.sqrt(distance)
                    if found < promise[i]:
                        distances[n], promise[i], since[i] = distance, found, total[i]
                        arcs[n], last[i], torques[n, arc[i]] = arc[i] + 1, age[i], x[HELD + i]
                # No later instant can promise more?
                goes_on = (total[i] - since[i]) * w0 <= weight * math.sqrt(distances[n])
                goes_on = goes_on and steps[i] < _MOST_STEPS and total[i] < p.longest / w0
            if not goes_on:
                done += steps[i]
                if arcs[n] > 0:
                    durations[n, arcs[n] - 1] = last[i]
                lanes[i] = -1
                for m in range(6):
                    x[m * LANES + i] = 0.0


def _laws(task: SwingUpTask, rng: np.random.Generator, count: int, damped: bool) -> PumpingLaws:
    """Return variants of the law at random, `damped` for a disk that the pendulum swings."""
    crossing = task.disk_acceleration / task.plant.natural_frequency**2 / task.disk_angle_limit

    def spread(least: float, most: float) -> Array:
        return np.exp(rng.uniform(math.log(least), math.log(most), count))

    def mostly(share: float, usual: float | Array, others: Array) -> Array:
        return np.where(rng.uniform(size=count) < share, usual, others)

    # The torque that takes half a swing to move the disk through its range, about.
    in_a_swing = np.minimum(spread(0.5, 1.5) / crossing, 1.0)
    # How much quicker than a swing all of the torque moves it through its range: 0 to 1.
    quick = min(max(math.log(crossing / 0.7) / math.log(3.0 / 0.7), 0.0), 1.0)
    narrow, damped = crossing > 0.5, damped and quick < 1.0  # swings wait for the disk
    lead = mostly(0.4, 0.0, rng.uniform(-0.4, 0.8 if narrow else 0.4, count))
    if narrow:
        # From where a large swing turns a stroke would be slow, and end in the wrong half.
        late = rng.uniform(-6.0 if damped else -2.5 - 2.0 * quick, -0.5 - 0.5 * quick, count)
        lead = mostly(0.5 - 0.4 * quick, lead, late)
    momentum = spread(0.02, 0.5) * min(max(1.5 * crossing, 1.0), 5.0)
    less = spread(0.3 / max(crossing, 2.0), 1.0)
    return PumpingLaws(
        first=np.where(np.arange(count) % 2, 1.0, -1.0),
        share=mostly(0.7 + 0.2 * quick, 1.0, mostly(0.3, less, in_a_swing)),
        on_place=spread(0.003, 0.6) * (1.0 if narrow else max(crossing / 0.15, 0.2)),
        on_momentum=spread(0.1, 10.0) if damped else momentum,
        band=spread(0.05, 1.0) if narrow else spread(0.03, 0.6),
        brake=rng.uniform(0.25 if damped else 0.6 - 0.08 * quick, 1.0 - 0.15 * quick, count),
        lead=lead,
        hold=mostly(0.25, 0.0, rng.uniform(0.2, 1.2, count)),
        weight=_over_drive(task, _WORK, _WEIGHT) * spread(1.0, _MOST_WEIGHT),
        shake=mostly(0.5 - 0.25 * quick if narrow else 1.0, _NEVER, np.full(count, _SHAKEN)),
    )


def pumped_candidates(
    task: SwingUpTask, rng: np.random.Generator, most: int, until: Budget
) -> tuple[list[Candidate], int]:
    """
    Pump by many variants and land the most promising, in time.

    Returns those that arrived, the quickest first, and how many variants were tried. A plan has at
    most `most` arcs.
    """
    swings, tried = list[Candidate](), 0
    while tried < _MOST_VARIANTS and not until.spent:
        if len(swings) >= (1 if until.past(_AT_LEISURE) else _SWINGS_A_LANE) * LANES:
            break
        tried += _VARIANTS
        swings += _swings(task, _laws(task, rng, _VARIANTS, tried > _USUAL), most, until)
    swings.sort(key=lambda candidate: candidate.total)
    landed = list[Candidate]()
    for first in range(0, len(swings), _BATCH):
        if until.spent or len(landed) >= (1 if until.past(_ONE_DOES) else _ENOUGH):
            break
        some = slice(first, first + _BATCH)
        landed += shoot_upright(task, swings[some], TAIL_STEPS, until, _ENOUGH)
    return to_polish(landed), tried


def _swings(task: SwingUpTask, variants: PumpingLaws, most: int, until: Budget) -> list[Candidate]:
    """Return the promising variants, the best first, with a tail to land by."""
    w0, room = task.plant.natural_frequency, max(most - _EXTRA, FEWEST_ARCS - _EXTRA)
    durations, torques = np.zeros((_VARIANTS, room)), np.zeros((_VARIANTS, room))
    arcs, distances = np.zeros(_VARIANTS, np.intp), np.full(_VARIANTS, np.inf)
    weight = _RANK * _over_drive(task, _WORK, _WEIGHT)
    turn = math.nan if task.turns is None else float(task.turns)
    longest = min(_over_drive(task, _LONGEST_WORK, _LEAST_LONGEST), _MOST_LONGEST)
    common = PumpingConstants(task.planned_torque, task.planned_disk_angle, w0, turn, longest)

    def work(first: int) -> int:
        rows = slice(first, first + LANES)
        laws = PumpingLaws(*(each[rows] for each in variants))
        return simulate_variants(
            task.plant.coefficients, task.start, common, laws,
            durations[rows], torques[rows], arcs[rows], distances[rows],
        )  # fmt: skip

    for first in range(0, _VARIANTS, _BATCH):
        if until.spent:
            break
        steps = sum_in_threads(work, range(first, first + _BATCH, LANES))
        until.evaluations += math.ceil(steps / _EVALUATION)
    total = np.where(np.arange(room) < arcs[:, None], durations, 0.0).sum(axis=1)
    promise = np.where(distances < _NEAR, w0 * total + weight * np.sqrt(distances), np.inf)
    best = np.argsort(promise)[:_LANDED]
    return [
        _with_tail(task, durations[i, : arcs[i]], torques[i, : arcs[i]])
        for i in best[np.isfinite(promise[best])]
    ]


def _with_tail(task: SwingUpTask, durations: Array, torques: Array) -> Candidate:
    """Return arcs that pump and a few more; all but the last ones are to stay as they are."""
    extra = max(_EXTRA, FEWEST_ARCS - durations.size)
    signs = -math.copysign(task.planned_torque, torques[-1]) * (-1.0) ** np.arange(extra)
    tail = round(min(_over_drive(task, _TAIL_WORK, _TAIL[0]), _TAIL[1]))
    return Candidate(
        np.append(durations, np.full(extra, _SHORT / task.plant.natural_frequency)),
        np.append(torques, signs),
        0,
        max(durations.size + extra - tail, 0),
    )


def _over_drive(task: SwingUpTask, work: float, least: float) -> float:
    """Return `work` over the drive, or `least` where that is more; the drive is 1e-6 at least."""
    return max(work / max(task.swing_drive, 1e-6), least)

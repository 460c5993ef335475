# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Direction and magnitude of the thrust when the thruster turns at a limited rate.

A robot that accelerates and then brakes turns its thrust by half a turn while little thrust is
wanted. An error of the direction costs a lateral acceleration F sin(error), so the error allowed
at an instant is e / F for some acceleration e. The smallest e is sought for which a direction
exists that is within the allowed errors at all instants and turns no faster than the limit: the
upper and lower envelopes of the allowed directions, with the limit as their Lipschitz constant,
must not cross. One causal pass then follows the wanted direction between the envelopes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

Array = NDArray[np.float64]

_ANY_DIRECTION = 50.0  # [rad] an allowed error that allows everything
_RATE_SHARE = 0.98  # of the limit used to turn
_SLACK = 1.2  # over the least error, so that small changes of what is wanted fit in
_BISECTIONS = 12


class Envelopes(NamedTuple):
    """Directions [rad] between which the thruster can be, (n,) each."""

    upper: Array
    lower: Array

    @property
    def open(self) -> bool:  # noqa: A003
        """Whether some admissible direction exists at all instants."""
        return bool((self.upper >= self.lower).all())


class ThrustDirection:
    """
    Follow wanted accelerations (n, 2) [m/s^2] at evenly spaced `times` (n,) s.

    `yaw` (n,) rad; `rate` [rad/s] limits the thruster, `thrust` [m/s^2] the acceleration; `alpha`
    is the thruster's angle at the start, NaN where it is free.
    """

    def __init__(
        self, times: Array, wanted: Array, yaw: Array, rate: float, thrust: float, alpha: float
    ) -> None:
        self.times, self.yaw = times, yaw
        self.rate, self.thrust, self.alpha = rate, thrust, alpha
        self.steps = np.diff(_RATE_SHARE * rate * times)
        self.turns = np.zeros(len(wanted))
        self.heading = np.unwrap(self._headings(wanted))
        if not np.isnan(alpha):
            away = self.heading[0] - yaw[0] - alpha
            self.heading -= 2 * np.pi * np.round(away / (2 * np.pi))
        self.error = self._least_error(wanted)
        if self.error > 0.002 * thrust:
            self._reconsider_turns(wanted)

    def _headings(self, wanted: Array) -> Array:
        """Headings of the wanted accelerations, held where nothing is wanted (n,) rad."""
        heading = np.arctan2(wanted[:, 1], wanted[:, 0])
        idle = np.hypot(wanted[:, 0], wanted[:, 1]) < 1e-9 * self.thrust
        if idle.all():
            return np.zeros(len(wanted))
        powered = np.maximum.accumulate(np.where(idle, -1, np.arange(len(wanted))))
        return np.asarray(heading[np.where(powered < 0, int(np.argmin(idle)), powered)])

    def directions(self, wanted: Array) -> Array:
        """
        Directions of the wanted accelerations from the robot's front, continuous (n,) rad.

        They stay on the branch of the accelerations first asked for, which may differ a little.
        """
        change = np.angle(np.exp(1j * (self._headings(wanted) - self.heading)))
        return np.asarray(self.heading + change - self.yaw + self.turns)

    def envelopes(self, wanted: Array, direction: Array, error: float) -> Envelopes:
        """Envelopes of the directions within `error` [m/s^2] of what is wanted."""
        force = np.maximum(np.hypot(wanted[:, 0], wanted[:, 1]), 1e-12)
        allowed = np.minimum(error / force, _ANY_DIRECTION)
        upper, lower = direction + allowed, direction - allowed
        if not np.isnan(self.alpha):
            upper[0] = lower[0] = self.alpha
        envelopes = Envelopes(upper, lower)
        _enclose(*envelopes, self.steps)
        return envelopes

    def _least_error(self, wanted: Array) -> float:
        direction = self.directions(wanted)
        if self.envelopes(wanted, direction, 1e-9 * self.thrust).open:
            return 1e-9 * self.thrust
        low, high = 0.0, 6.0 * self.thrust
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high) if low > 0 else 0.25 * high
            if self.envelopes(wanted, direction, middle).open:
                high = middle
            else:
                low = middle
            if high < 1e-4 * self.thrust:
                break
        return high

    def _reconsider_turns(self, wanted: Array) -> None:
        """Turn the other way round at a minimum of the thrust, where that is better."""
        force = np.hypot(wanted[:, 0], wanted[:, 1])
        step = np.diff(self.directions(wanted))
        fast = np.abs(step) > 2 * self.rate * np.diff(self.times)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], fast.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            after = end + 1
            at = begin + int(np.argmin(force[begin:after])) + 1
            kept, error = self.turns, self.error
            turned = kept.copy()
            turned[at:] -= np.sign(step[begin:end].sum()) * 2 * np.pi
            self.turns = turned
            self.error = self._least_error(wanted)
            if self.error >= error:
                self.turns, self.error = kept, error

    def follow(self, wanted: Array) -> tuple[Array, Array]:
        """
        Thruster angle [rad] and rate [rad/s] (n,) that follow the wanted accelerations.

        The rate runs linearly between samples, the angle is its exact integral. A thruster whose
        thrust is never wanted rests.
        """
        if np.abs(wanted).max() < 1e-9 * self.thrust:
            rest = 0.0 if np.isnan(self.alpha) else self.alpha
            return np.full(len(wanted), rest), np.zeros(len(wanted))
        direction = self.directions(wanted)
        error = _SLACK * self.error
        envelopes = self.envelopes(wanted, direction, error)
        while not envelopes.open and error < 6.0 * self.thrust:
            error = max(1.1 * error, 1e-5 * self.thrust)
            envelopes = self.envelopes(wanted, direction, error)
        upper, lower = envelopes
        # Where no direction will do, the thruster still starts where it stands.
        first = self.alpha
        if np.isnan(first):
            first = min(max(float(direction[0]), float(lower[0])), float(upper[0]))
        angles = np.empty(direction.size)
        _follow(direction, lower, upper, self.steps, first, angles)
        return self._smoothed(angles)

    def _smoothed(self, angles: Array) -> tuple[Array, Array]:
        steps = np.diff(self.times)
        slopes = np.diff(angles) / steps
        padded = np.concatenate([slopes[:1], slopes, slopes[-1:]])
        rate = 0.5 * (padded[1:] + padded[:-1])
        turned = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * steps)
        return np.concatenate([angles[:1], angles[0] + turned]), rate


def compile_following() -> None:
    """Compile the kernel or load it from the disk."""
    _follow(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(1), 0.0, np.zeros(2))
    _enclose(np.zeros(2), np.zeros(2), np.zeros(1))


@compiled
def _follow(
    wished: Array, lower: Array, upper: Array, steps: Array, first: float, angles: Array
) -> None:
    """Fill `angles` (n,): as desired within the envelopes, in `steps` (n - 1,) at most."""
    angle = angles[0] = first
    for k in range(1, wished.size):
        step = steps[k - 1]
        least, most = max(lower[k], angle - step), min(upper[k], angle + step)
        angle = max(min(max(wished[k], least), most, angle + step), angle - step)
        angles[k] = angle


@compiled
def _enclose(upper: Array, lower: Array, steps: Array) -> None:
    """Tighten bounds (n,) to what can be reached from all others with `steps` (n - 1,) at most."""
    last = steps.size
    for k in range(last):
        upper[k + 1] = min(upper[k + 1], upper[k] + steps[k])
        lower[k + 1] = max(lower[k + 1], lower[k] - steps[k])
    for k in range(last - 1, -1, -1):
        upper[k] = min(upper[k], upper[k + 1] + steps[k])
        lower[k] = max(lower[k], lower[k + 1] - steps[k])

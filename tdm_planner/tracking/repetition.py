# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Sensors that repeat themselves, told from a plant at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.tracking.estimator import StateEstimator

Array = NDArray[np.float64]

_UNMISTAKABLE = 20.0  # standard deviations of the measurement
_ON_ITS_WAY = 0.25  # of a window that a command and the state after it may take
_LONGEST = 4  # windows without a change that are looked at together


class RepetitionWatch:
    """
    Notices a driver that goes on publishing, with fresh stamps, what it measured long ago.

    Samples that stay the same to the last bit for `window` s, twice or four times as long are
    compared with the motion that the commands sent since must have caused. If that is far beyond
    the noise, the sensor is `stuck`, until it shows another number or the plant should rest. The
    last commands may be on their way still: they are ignored. What happens in gaps of more than
    `window` s between samples is not judged.
    """

    def __init__(self, estimator: StateEstimator, window: float) -> None:
        self._estimator = estimator
        self._window = window
        self._sample: Array | None = None
        self._since = self._last = 0.0
        self._next = 1
        self.stuck = False

    def observe(self, state: Array, stamp: float) -> None:
        """Take a sample (nx,) of the instant `stamp` [s], later than that of the one before."""
        sample, before, self._last = self._sample, self._last, stamp
        if sample is None or not np.array_equal(state, sample) or stamp <= self._since:
            self._sample, self.stuck = state.copy(), False
            self._begin(stamp)
        elif stamp - before > self._window:
            self._begin(stamp)
        elif stamp - self._since >= self._next * self._window:
            self._judge(sample, stamp)

    def adopt(self, other: RepetitionWatch) -> None:
        """Go on with what another watch of the same sensor has seen."""
        self._sample, self.stuck = other._sample, other.stuck
        self._since, self._last, self._next = other._since, other._last, other._next

    def _begin(self, stamp: float) -> None:
        self._since, self._next = stamp, 1

    def _judge(self, sample: Array, stamp: float) -> None:
        """Compare with what the model makes of the commands sent while nothing changed."""
        estimator = self._estimator
        state, driven = sample, False
        seen = stamp - _ON_ITS_WAY * self._window
        for duration, control in estimator.history.between(self._since, seen):
            state = estimator.move(state, control, duration)
            driven = driven or bool(control.any())
        far = _UNMISTAKABLE * estimator.noise.measurement
        moves = not bool((np.abs(state - sample) <= far).all())
        # A plant without commands may rest where the model does not.
        self.stuck = moves and (driven or self.stuck)
        if self.stuck:
            self._begin(stamp)
            self._next = _LONGEST  # about upright it takes that long to tell falling from resting
        elif self._next >= _LONGEST:
            self._begin(stamp)
        else:
            self._next *= 2

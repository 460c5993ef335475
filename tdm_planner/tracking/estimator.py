# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The state at any instant, from late and noisy samples and the commands sent meanwhile.

With it come gains of the plant's model, which are estimated as further states, and whether a
sensor repeats itself.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
import math
from typing import Any, Final, Protocol

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.plants.base import integrate, Plant, SymbolicPlant

PREDICTION_STEP = 5e-3  # s, of a prediction, unless a plant needs shorter ones
_GAIN_UNKNOWN = 1e3  # standard deviation of gains that nothing measures directly
_LARGEST_SURPRISE = 20.0  # standard deviations; a push or a reset, not noise
_ILL_CONDITIONED = 1e6  # times the prior standard deviation: rounding outweighs what is known
_UNMISTAKABLE = 20.0  # standard deviations of the measurement
_ON_ITS_WAY = 0.25  # of a window that a command and the state after it may take
_DELAY_SPREAD = 5e-3  # s, standard deviation of the delay of commands around the initial guess
_FARTHEST = 0.01  # s by which the estimate of the delay differs from the guess, at most
_JITTER = 1e-3  # s, standard deviation of the delay from one command to the next
_LEARNING = 0.1  # of the gradient of a sample's log-likelihood, that the model's error follows
MOST_WINDOWS = 4  # without a change, that are looked at together


class DifferentiablePlant(Plant, Protocol):
    """A plant with the derivatives of its equations of motion."""

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (..., nx, nx) and df/du (..., nx, nu)."""


class PlantWithGains(SymbolicPlant):
    """A plant with more states: constant gains of its model, that are estimated with the rest."""

    def __init__(self, plant: SymbolicPlant) -> None:
        self._plant = plant

    @property
    def coefficients(self) -> Any:
        """Constants of the equations of motion."""
        return self._plant.coefficients


class CommandHistory:
    """The controls sent in the last `span` s, each valid until the next one; zero before."""

    def __init__(self, size: int, span: float) -> None:
        self._zero, self._span = np.zeros(size), span
        self._times: list[float] = []
        self._controls: list[Array] = []

    def add(self, time: float, control: Array) -> None:
        """Note that `control` (nu,) was sent at `time` [s], in place of later ones."""
        while self._times and self._times[-1] >= time:
            self._times.pop()
            self._controls.pop()
        self._times.append(time)
        self._controls.append(control)
        if self._times[0] < time - 2 * self._span:
            kept = bisect_right(self._times, time - self._span) - 1
            del self._times[:kept], self._controls[:kept]

    def clear(self) -> None:
        """Forget every command."""
        self._times.clear()
        self._controls.clear()

    def take(self, other: CommandHistory) -> None:
        """Remember what another history does, in place of what this one did."""
        self._times, self._controls = [*other._times], [*other._controls]

    def between(self, start: float, end: float) -> Iterator[tuple[float, Array]]:
        """Durations [s] and controls that make up [start, end]."""
        index = bisect_right(self._times, start)
        time = start
        while time < end:
            control = self._controls[index - 1] if index else self._zero
            until = min(self._times[index], end) if index < len(self._times) else end
            yield until - time, control
            time = until
            index += 1

    def at(self, time: float) -> Array:
        """Return the control (nu,) that was sent last before `time` [s]."""
        index = bisect_left(self._times, time)
        return self._controls[index - 1] if index else self._zero


@dataclass(frozen=True, eq=False)
class EstimatorNoise:
    """
    What the samples and the model are worth.

    `measurement` (n,) are the standard deviations of the measured states; `model` is the largest
    relative error of the plant's rates, which stays about the same for `lasting` s. `rate_floor`
    (n,) is the least magnitude of a rate that is assumed; 0 where rates are exact (of positions).
    How large the model's error is, is found out, down to its share `least` of `model`. `gains` is
    the standard deviation, at first, of the states that the plant has beyond the measured ones.
    """

    measurement: Array
    model: float
    rate_floor: Array
    gains: float = 0.0
    lasting: float = 0.0
    least: float = 1.0


class StateEstimator:
    """
    An extended Kalman filter in continuous-discrete form (Gelb, "Applied Optimal Estimation").

    Samples carry the instant they were taken; between samples the estimate follows the plant's
    equations of motion under the commands noted in its `history`. Sensors may report the states at
    the places `angles` modulo 2 pi: the estimate runs on continuously. A sample that noise and
    model cannot explain (a push, a reset) is believed. After one that is absurd, so that nothing
    can be predicted from it, the estimate begins anew. No step of the prediction is longer than
    `longest_step` s.

    The model's error, within what `noise` assumes, follows the gradient of the likelihood of every
    sample (Mehra, "Approaches to adaptive filtering", 1972).

    Commands act `delay` s after they were sent. The delay is a further state of the filter: an
    error of it shifts the instant at which a control changes, and so the state, by that time times
    the difference of the rates. It is taken as constant, and estimated where `find_delay` says so.
    About a goal, friction depends on the commands, too, and would be taken for a delay. The
    constructor takes its initial guess.
    """

    def __init__(
        self,
        plant: DifferentiablePlant,
        noise: EstimatorNoise,
        angles: list[int],
        longest_gap: float,
        longest_step: float = PREDICTION_STEP,
        delay: float = 0.0,
    ) -> None:
        self._plant = plant
        self.noise = noise
        self.size = len(plant.state_names)
        span = (MOST_WINDOWS + 1) * longest_gap + delay + _FARTHEST  # that is looked back on
        self.history = CommandHistory(len(plant.control_names), span)
        self.longest_gap, self._longest_step = longest_gap, longest_step
        self.angles = angles
        more = (0, self.size - noise.measurement.size)
        self._rate_floor = np.pad(noise.rate_floor, more)
        self.measurement = np.pad(noise.measurement, more, constant_values=_GAIN_UNKNOWN)
        self._measurement_covariance = np.diag(self.measurement**2)
        prior = np.pad(noise.measurement, more, constant_values=noise.gains)
        self._prior_covariance = np.diag(np.append(prior, _DELAY_SPREAD) ** 2)  # last: the delay
        self._guess = self.delay = delay
        self._finds_delay = False
        self._error_share = 1.0  # of the model's error that is assumed
        self.stamp: float | None = None
        self._state = np.zeros(self.size)
        self._covariance = self._prior_covariance

    def reset(self) -> None:
        """Forget every sample, and what delay and model's error were found to be."""
        self.stamp, self.delay, self._error_share = None, self._guess, 1.0

    def go_on_from(self, other: StateEstimator, alike: bool) -> None:
        """
        Take over commands and newest state, and the delay if it began with the same guess.

        Gains, too, if the models are `alike`: they are shares of the model's constants.
        """
        self.history.take(other.history)
        if self._guess == other._guess:
            self.delay = other.delay
        if other.stamp is not None:
            state, measured = other.predict(other.stamp).copy(), self.noise.measurement.size
            if not alike:
                state[measured:] = 1.0
            self.observe(state, other.stamp)

    def acting(self, start: float, end: float) -> Iterator[tuple[float, Array]]:
        """Durations [s] and controls that make up [start, end], as they act on the plant."""
        return self.history.between(start - self.delay, end - self.delay)

    def find_delay(self, finds: bool) -> None:
        """Let samples correct the delay of commands or not; first it counts as unknown again."""
        if finds and not self._finds_delay:
            self._covariance = self._covariance.copy()
            self._covariance[-1] = self._covariance[:, -1] = self._prior_covariance[-1]
        self._finds_delay = finds

    def observe(self, state: Array, stamp: float) -> None:
        """
        Take a measured state (nx,) of the instant `stamp` [s]; older ones are ignored.

        Raise ArithmeticError or numpy.linalg.LinAlgError if the estimate breaks down.
        """
        if self.stamp is not None and stamp <= self.stamp:
            return
        known = self.stamp is not None and stamp - self.stamp <= self.longest_gap
        if known:
            self._propagate(stamp)
            most = _ILL_CONDITIONED**2 * np.diag(self._prior_covariance)
            known = bool((np.diag(self._covariance) <= most).all())
        if known:
            self._correct(state)
        else:
            self._state, self._covariance = state.copy(), self._prior_covariance
        self.stamp = stamp
        _check_finite(self._state)

    def predict(self, time: float) -> Array:
        """
        State (nx,) at `time` [s], not before the newest sample's stamp.

        Raise FloatingPointError if it is not finite.
        """
        assert self.stamp is not None
        state = self._state
        for duration, control in self.acting(self.stamp, time):
            state = self.move(state, control, duration)
        _check_finite(state)
        return state

    def move(self, state: Array, control: Array, duration: float) -> Array:
        """State (nx,) after `duration` s under a held control (nu,), as the model has it."""
        return integrate(self._plant, state, control, duration, self._longest_step)

    def _propagate(self, until: float) -> None:
        assert self.stamp is not None
        noise, size = self.noise, self.size
        before = self.history.at(self.stamp - self.delay)
        for duration, control in self.acting(self.stamp, until):
            slope, _ = self._plant.jacobians(self._state, control)
            rates = self._plant.derivative(self._state, control)
            step = slope * duration
            transition = np.eye(size + 1)
            transition[:size, :size] += step + 0.5 * step @ step
            late = np.zeros(size)  # slope of the state by the delay
            if (control != before).any():
                late = self._plant.derivative(self._state, before) - rates
            transition[:size, size] = late = transition[:size, :size] @ late
            self._covariance = transition @ self._covariance @ transition.T
            # The model's error is about constant for a while: until then it adds up with the time.
            spread = self._error_share * noise.model * np.maximum(np.abs(rates), self._rate_floor)
            spread *= self._rate_floor > 0.0
            lasting = max(duration, noise.lasting)
            noises = np.diag(spread**2 * duration * lasting) + _JITTER**2 * np.outer(late, late)
            self._covariance[:size, :size] += noises
            self._state = self.move(self._state, control, duration)
            before = control

    def _correct(self, measured: Array) -> None:
        innovation = measured - self._state
        innovation[self.angles] = wrapped(innovation[self.angles])
        size = self.size
        total = self._covariance[:size, :size] + self._measurement_covariance
        weighed = np.linalg.solve(total, innovation)
        if innovation @ weighed > _LARGEST_SURPRISE**2:
            self._state = self._state + innovation
            self._covariance = self._prior_covariance
            return
        gain = np.linalg.solve(total, self._covariance[:size]).T
        gain[size] *= self._finds_delay
        correction = gain @ innovation
        # The covariance, nearly all of which comes of the model's error, grows with its square.
        slope = float(correction[:size] @ weighed - np.trace(gain[:size]))
        share = self._error_share * math.exp(_LEARNING * slope)
        self._error_share = min(max(share, self.noise.least), 1.0)
        self._state = self._state + correction[:size]
        away = self.delay + float(correction[size]) - self._guess
        self.delay = max(self._guess + min(max(away, -_FARTHEST), _FARTHEST), 0.0)
        covariance = self._covariance - gain @ self._covariance[:size]
        covariance[size] = covariance[:, size]  # also where the delay is not corrected
        self._covariance = 0.5 * (covariance + covariance.T)


def _check_finite(state: Array) -> None:
    if not np.isfinite(state).all():
        raise FloatingPointError('the estimated state is not finite')


STUCK: Final = (
    'the measured state stays the same to the last digit, although what was commanded must move '
    'the plant: is a sensor stuck?'
)


class RepetitionWatch:
    """
    Notices a driver that goes on publishing, with fresh stamps, what it measured long ago.

    Samples that stay the same to the last bit for a window, twice or four times as long are
    compared with the motion that the commands sent since must have caused. If that is far beyond
    the noise, and beyond `rest_slack`, by which the model may move while the plant rests, the
    sensor is `stuck`, until it shows another number or the plant should rest. The last commands
    may be on their way still: they are ignored. A window is the longest gap between samples that
    the estimator predicts over; what happens in a longer one is not judged.
    """

    def __init__(self, estimator: StateEstimator) -> None:
        self._estimator = estimator
        self._sample: Array | None = None
        self._since = self._last = 0.0
        self._next = 1
        self.stuck = False

    def observe(self, state: Array, stamp: float, rest_slack: Array | float = 0.0) -> None:
        """Take a sample (nx,) of the instant `stamp` [s], later than that of the one before."""
        sample, before, self._last = self._sample, self._last, stamp
        window = self._estimator.longest_gap
        if sample is None or not np.array_equal(state, sample) or stamp <= self._since:
            self._sample, self.stuck = state.copy(), False
            self._begin(stamp)
        elif stamp - before > window:
            self._begin(stamp)
        elif stamp - self._since >= self._next * window:
            self._judge(sample, stamp, rest_slack)

    def of(self, estimator: StateEstimator) -> RepetitionWatch:
        """Return a watch by another estimator that knows what this one has seen."""
        watch = copy(self)
        watch._estimator = estimator
        return watch

    def _begin(self, stamp: float) -> None:
        self._since, self._next = stamp, 1

    def _judge(self, sample: Array, stamp: float, rest_slack: Array | float) -> None:
        """Compare with what the model makes of the commands sent while nothing changed."""
        estimator = self._estimator
        state, driven = sample, self.stuck
        seen = stamp - _ON_ITS_WAY * estimator.longest_gap
        for duration, control in estimator.acting(self._since, seen):
            driven = driven or bool(control.any())
            if driven:  # a plant without commands may rest where the model does not
                state = estimator.move(state, control, duration)
        far = np.maximum(_UNMISTAKABLE * estimator.measurement, rest_slack)
        self.stuck = not bool((np.abs(state - sample) <= far).all())
        if self.stuck:
            self._begin(stamp)
            # About upright it takes that long to tell falling from resting.
            self._next = MOST_WINDOWS
        elif self._next >= MOST_WINDOWS:
            self._begin(stamp)
        else:
            self._next *= 2

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Tracking of a stated problem's plans: time-varying LQR by traced Jacobians, LQR at the end.

The control over the coming command interval is the mean of the planned one less K(t) times the
deviation, saturated at `control_limits` and where `margins` end. The weights count a deviation as
a share of what the plan's states and controls run through, unless the problem gives
`feedback_weights`. Where the end can be held at rest by some control, a regulator about it takes
over; else the motion is over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tdm_planner.arrays import Array, largest_of_unit, Mask
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.parameters import group, positive
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.tracking.estimator import EstimatorNoise, MOST_WINDOWS, StateEstimator
from tdm_planner.tracking.linear_quadratic import (
    discrete_regulator,
    mean_controls,
    moved,
    PlanLaw,
)
from tdm_planner.tracking.motion import Action, Motion, Steps, Tolerances, TrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import Trajectory

GOAL_SHARE = 0.05  # of a state's range: so near to a given end it counts as reached
_FEWEST_GAINS, _GAIN_STEP = 100, 5e-3  # along a plan, and s between two
_AT_REST = 1e-3  # share of the largest rate of a plan that counts as rest at its end
_TOUCHED, _HALVINGS = 1e-3, 8  # share of a limit that feedback may use; to what it allows
_NEWTON, _SETTLED = 20, 1e-12  # steps, at most, to the control that holds the end
_SHARES = 10.0  # weight of a deviation as large as the range, against that of the control
# Ranges of states: of the largest of the same unit; of the problem's ends and earlier plans.
_LEAST_RANGE, _SHORT = 1e-2, 0.1
_LEAST_REACH = 1e-4  # of what the controls could change a state by
_FRICTION = 0.1  # share of the largest controls that friction, and the model's error, may take
_BELIEVED = 1e-6, 1e3  # measurement error, and that of the model's rates: states are believed


@dataclass(frozen=True)
class StatedTolerances(Tolerances):
    """How far the state may be from the trajectory, in shares of the ranges of a plan's states."""

    start: float = positive(
        0.3,
        'largest deviation at the start for a trajectory to be accepted, as a share of the range '
        "of a plan's state",
    )
    path: float = positive(
        0.5,
        'deviation from the plan at which the motion is aborted, as a share of the range of a '
        "plan's state",
    )


@dataclass(frozen=True)
class StatedTrackerParameters(TrackerParameters):
    """Parameters of a stated plant's tracker, beside those of its problem."""

    tolerance: StatedTolerances = group(StatedTolerances)


@dataclass(frozen=True, eq=False)
class Hold:
    """
    How an end is held: state (nx,), control (nu,), gain (nu, nx).

    Only deviations of states that move there count, a mask (nx,).
    """

    state: Array
    control: Array
    gain: Array
    counts: Mask


@dataclass(frozen=True, eq=False)
class StatedLaw:
    """
    What is prepared of a plan: its law, and how both ends are held.

    `ranges` (nx,) are those of the states, in shares of which deviations count; `touched` is what
    feedback may violate limits by in which controls have a part; `rest_slack` (nx,) is by how much
    the model may move while friction holds the plant.
    """

    law: PlanLaw
    ranges: Array
    begin: Hold | None
    end: Hold | None
    touched: Array
    rest_slack: Array


class StatedTracker(TrajectoryTracker):
    """Tracker of any `DirectProblem`; deviations are shares of the range of a plan's states."""

    plant: DirectPlant
    settling = 1.0

    def __init__(self, problem: DirectProblem, parameters: TrackerParameters) -> None:
        self.problem, plant = problem, DirectPlant(problem)
        nx = len(problem.state_names)
        measured, model = _BELIEVED
        noise = EstimatorNoise(np.full(nx, measured), model, rate_floor=np.ones(nx))
        gap, delay = parameters.state_timeout, parameters.command_delay
        estimator = StateEstimator(plant, noise, [], gap, delay=delay)
        super().__init__(parameters, plant, estimator)
        self._lower, self._upper = plant.control_range
        self.limits = dict(zip(plant.control_names, plant.control_range.T.tolist(), strict=True))
        ends = Ends.of(plant.stated).states
        self._ends_at_goal = np.isfinite(ends[1])  # (nx,)
        # A plan from beside the goal to the goal must not make a deviation of nothing a large one.
        self._least_ranges = _SHORT * np.nan_to_num(np.abs(np.diff(ends, axis=0)[0]))

    def observe(self, state: Array, stamp: float) -> None:
        """Take a measured state (nx,); dry friction may hold a plant that the model moves."""
        if self.newest is not None:
            self.rest_slack = self.newest.law.rest_slack
        super().observe(state, stamp)

    def prepare(self, trajectory: Trajectory) -> Steps[StatedLaw]:
        """Compute the gains along the plan."""
        plant = self.plant
        smooth = trajectory.with_rates(plant.derivative)
        ranges = self._scales(trajectory)
        weights = self._weights(trajectory, ranges)
        hold, terminal = self._held(smooth, -1, *weights)
        begin, _ = self._held(smooth, 0, *weights)
        yield
        interval = self.parameters.interval
        # Gains for controls held more shortly would throw a quick plant off its plan.
        spacing = max(min(trajectory.duration / _FEWEST_GAINS, _GAIN_STEP), interval)
        law = yield from PlanLaw.along(plant, smooth, weights, terminal, spacing, interval)
        samples = zip(trajectory.times, trajectory.states, trajectory.controls, strict=True)
        left = np.array([plant.control_margins(*sample) for sample in samples])
        touched = _TOUCHED * np.minimum(np.abs(np.nan_to_num(left)).max(axis=0), 1.0)
        a, _ = plant.jacobians(trajectory.states, trajectory.controls)
        growths = np.linalg.eigvals(a[np.isfinite(a).all(axis=(1, 2))]).real
        self.growth_rate = float(growths.max(initial=0.0))
        slack = _FRICTION * self._reach(trajectory, MOST_WINDOWS * self.parameters.state_timeout)
        return StatedLaw(law, ranges, begin, hold, touched, np.nan_to_num(slack))

    def _scales(self, trajectory: Trajectory) -> Array:
        """
        Return the range of every state (nx,), not less than a share of others of its unit.

        Nor less than a share of that between the problem's ends, and along earlier plans that were
        tracked, and of what the controls could change it by: all of a unit may rest.
        """
        found = np.maximum(np.ptp(trajectory.states, axis=0), self._least_ranges)
        least = _LEAST_RANGE * largest_of_unit(found, self.problem.state_units)
        reach = self._reach(trajectory, trajectory.duration)
        return np.asarray(np.maximum.reduce([found, least, _LEAST_REACH * reach + 1e-9]))

    def _reach(self, trajectory: Trajectory, time: float) -> Array:
        """Return about what the controls could change every state (nx,) by in so many s."""
        jacobians = self.plant.jacobians(trajectory.states, trajectory.controls)
        a, b = (time * np.abs(part).max(axis=0) for part in jacobians)
        driven, reach = b @ self._sizes(trajectory), np.zeros(len(b))
        for _ in reach:  # from controls to rates, from rates to places
            reach = np.where(reach > 0.0, reach, a @ reach + driven)
        return np.asarray(reach)

    def _sizes(self, trajectory: Trajectory) -> Array:
        """Return half the range of every control (nu,), along the plan if it is not limited."""
        span = np.ptp(trajectory.controls, axis=0)
        limited = np.isfinite(self._upper - self._lower)
        return np.asarray(0.5 * np.where(limited, self._upper - self._lower, span))

    def _weights(self, trajectory: Trajectory, ranges: Array) -> tuple[Array, Array]:
        given = self.problem.feedback_weights()
        if given is not None:
            q, r = (np.atleast_2d(np.asarray(part, dtype=float)) for part in given)
            return q, r
        time, size = trajectory.duration, np.maximum(self._sizes(trajectory), 1e-9)
        q = np.diag((_SHARES / ranges) ** 2) / time
        return q, np.diag(1.0 / size**2) / time

    def _resting(self, trajectory: Trajectory, end: int) -> Array | None:
        """Return the control (nu,) under which an end is at rest, None if there is none."""
        plant, state = self.plant, trajectory.states[end]
        control = np.clip(self.nothing, self._lower, self._upper)
        for _ in range(_NEWTON):
            rates = plant.derivative(state, control)
            _, b = plant.jacobians(state, control)
            if not np.isfinite(b).all():  # as of the size of a thrust that is nothing
                control = trajectory.controls[end]
                _, b = plant.jacobians(state, control)
            if not np.isfinite(b).all():
                return None
            before = control
            control = np.clip(control - np.linalg.pinv(b) @ rates, self._lower, self._upper)
            if np.allclose(control, before, rtol=_SETTLED, atol=0.0):
                break
        assert trajectory.rates is not None
        largest = np.abs(trajectory.rates).max(axis=(0, 1))
        still = np.abs(plant.derivative(state, control)) <= _AT_REST * largest + 1e-9
        return np.asarray(control) if still.all() else None

    def _held(
        self, trajectory: Trajectory, end: int, q: Array, r: Array
    ) -> tuple[Hold | None, Array]:
        """Return how an end is held, if it can be, and the weight of a deviation there."""
        state, not_held = trajectory.states[end], (None, trajectory.duration * 10.0 * q)
        control = self._resting(trajectory, end)
        if control is None:
            return not_held
        a, b = self.plant.jacobians(state, control)
        try:
            found = discrete_regulator(a, b, q, r, self.parameters.interval)
        except np.linalg.LinAlgError:
            return not_held
        return Hold(state, control, found.gain, moved(a, b)), found.cost_to_go

    def deviation(self, motion: Motion, error: Array) -> float:
        """Return the largest deviation as a share of what the plan's states run through."""
        prepared = motion.law is not None
        ranges = motion.law.ranges if prepared else self._scales(motion.trajectory)
        return float((np.abs(error) / ranges).max())

    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Mean planned control plus time-varying feedback."""
        law: PlanLaw = motion.law.law
        elapsed, interval = time - motion.start, self.parameters.interval
        first = law.trajectory.times[0] + elapsed
        planned = mean_controls(law.trajectory, [first, first + interval])[0]
        after = (elapsed + interval - law.trajectory.duration) / interval
        held = law.trajectory.controls[-1] if (end := motion.law.end) is None else end.control
        planned += min(max(after, 0.0), 1.0) * held
        reference = law.trajectory.sample(first).state
        return self._action(motion, planned, law.gain(elapsed), state, reference, elapsed)

    def at_goal(self, motion: Motion, state: Array) -> bool:
        """Whether every state whose end is given is near to it."""
        away = np.abs(self.error(state, motion.trajectory.states[-1]))
        return bool((away < GOAL_SHARE * motion.law.ranges)[self._ends_at_goal].all())

    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedback about the end; nothing where it cannot be held."""
        return self._about(motion, motion.law.end, state)

    def _take_over(self, time: float, state: Array) -> None:
        """Let a trajectory whose start has come take over, and remember its ranges."""
        before = self.current
        super()._take_over(time, state)
        if self.current is not None and self.current is not before:
            flown = _SHORT * self.current.law.ranges
            self._least_ranges = np.maximum(self._least_ranges, flown)

    def adopt(self, other: TrajectoryTracker) -> None:
        """Go on from where another tracker of the same plant is, and from its ranges."""
        assert isinstance(other, StatedTracker)
        self._least_ranges = np.maximum(self._least_ranges, other._least_ranges)
        super().adopt(other)
        if self.newest is other.newest:  # nothing was computed anew
            self.growth_rate = other.growth_rate

    def _check_start(self, motion: Motion, now: float) -> None:
        """
        Compare the state with the planned one.

        It stays as it is until a start ahead at which it is at rest; another is compared when it
        has come.
        """
        if now >= motion.start or self.current is not None:
            super()._check_start(motion, now)
        elif self.state_age(now) <= self.parameters.state_timeout:
            smooth = motion.trajectory.with_rates(self.plant.derivative)
            if self._resting(smooth, 0) is not None:
                self._compare(motion, self.estimator.predict(now), motion.start)

    def wait(self, motion: Motion, state: Array) -> Array:
        """Feedback about the start, where it can be held."""
        return self._about(motion, motion.law.begin, state).control

    def _about(self, motion: Motion, end: Hold | None, state: Array) -> Action:
        if end is None:
            return Action(self.nothing, self.nothing, np.zeros(state.size))
        action = self._action(motion, end.control, end.gain, state, end.state)
        return replace(action, error=end.counts * action.error)

    def _action(
        self,
        motion: Motion,
        planned: Array,
        gain: Array,
        state: Array,
        reference: Array,
        elapsed: float = 0.0,
    ) -> Action:
        """Return planned control and feedback, as much of it as the limits allow."""
        error = self.error(state, reference)
        control = np.clip(planned - gain @ error, self._lower, self._upper)
        margins = self.plant.control_margins
        least = np.minimum(margins(elapsed, reference, planned), 0.0) - motion.law.touched
        if (margins(elapsed, state, control) < least).any():
            low, high = 0.0, 1.0
            for _ in range(_HALVINGS):
                share = 0.5 * (low + high)
                between = planned + share * (control - planned)
                violated = (margins(elapsed, state, between) < least).any()
                low, high = (low, share) if violated else (share, high)
            control = planned + low * (control - planned)
        return Action(control, control - planned, error)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What every tracker does, whatever the plant: which trajectory is active, and what phase it is.

    idle        no trajectory yet: nothing is commanded
    waiting     a trajectory is accepted, its start lies ahead: what the plant's tracker does then;
                a pendulum gets no torque, a robot turns its thruster, a stated plant is held
    tracking    feedforward and feedback along the trajectory
    holding     the end has been reached: feedback about the goal
    stopped     the motion was aborted: nothing is commanded until the next trajectory
    recovering  the motion was aborted: the plant is brought to rest, then a new plan is requested

A trajectory that arrives while another is being tracked or held supersedes it at its own start.
Instants are seconds of one clock; which one does not matter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.exceptions import one_line
from tdm_planner.plants.base import Named
from tdm_planner.tracking.estimator import RepetitionWatch, StateEstimator, STUCK
from tdm_planner.tracking.motion import (
    Action,
    beyond_limits,
    check_trajectory,
    CLOCK_TOLERANCE,
    Command,
    finished,
    Motion,
    Phase,
    Steps,
    TrackerParameters,
    TrajectoryMissed,
    TrajectoryRejected,
    worst_state,
)
from tdm_planner.trajectory import Trajectory

BREAKDOWN = ArithmeticError, np.linalg.LinAlgError  # where numbers leave their range
_CALM_SLACK = 3.0
_LOOK_AHEAD = 100  # steps, at most, in which the state at a coming start is predicted
_LONGEST_FORESEEN = 10.0  # s ahead; for a later start the comparison is made when it has come
_LATELY = 10.0  # s since the end of a plan, in which a tracker that was restarted into it recovers


class TrajectoryTracker(ABC):
    """
    Commands that keep a plant on a trajectory; subclasses give the laws of one plant.

    Call `observe` for every state sample, `accept` for every trajectory and `command` at every
    tick of the clock. The goal is to be reached `settling` s after a trajectory's end.
    """

    settling: float
    limits: Mapping[str, tuple[float, float]]  # of controls, and of states, by name
    rest_slack: Array | float = 0.0  # (nx,) by which the model may move while the plant rests

    def __init__(
        self, parameters: TrackerParameters, plant: Named, estimator: StateEstimator
    ) -> None:
        self.parameters, self.plant, self.estimator = parameters, plant, estimator
        self.nothing = np.zeros(len(plant.control_names))  # commanded
        self._repetition = RepetitionWatch(estimator)
        self.phase, self.reason = Phase.IDLE, ''
        self.wants_plan = self._brakes = False
        self.current: Motion | None = None  # tracked or held
        self.pending: Motion | None = None  # accepted, until its start
        self.growth_rate = 0.0  # 1/s, at most, by which a deviation grows without feedback
        self._time = -math.inf
        self._notice = '', -math.inf  # what is told for a while, and since when

    @abstractmethod
    def prepare(self, trajectory: Trajectory) -> Steps[Any]:
        """Do what can be done before the start (gains); the result comes back as `motion.law`."""

    @abstractmethod
    def deviation(self, motion: Motion, error: Array) -> float:
        """Return an error along a motion as one number, in the unit of the plant's tolerances."""

    @abstractmethod
    def track(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedforward and feedback for the interval that begins at the instant `time` [s]."""

    @abstractmethod
    def at_goal(self, motion: Motion, state: Array) -> bool:
        """Whether the state (nx,) is that to which the motion leads, within a tolerance."""

    @abstractmethod
    def hold(self, motion: Motion, time: float, state: Array) -> Action:
        """Feedback about the end of the trajectory."""

    def error(self, state: Array, reference: Array) -> Array:
        """State, without gains, minus reference (nx,), angles the shorter way round."""
        error, angles = state[: reference.size] - reference, self.estimator.angles
        error[angles] = wrapped(error[angles])
        return error

    def paced(self, motion: Motion, time: float, state: Array) -> Motion:
        """Return the motion, put off or brought forward to where the plant is on it."""
        return motion

    def captured(self, motion: Motion, time: float, state: Array) -> bool:
        """Whether `hold` may take over from `track`."""
        return time >= motion.end

    def wait(self, motion: Motion, state: Array) -> Array:
        """Return the controls (nu,) before the start of `motion`."""
        return self.nothing

    def recover(self, state: Array) -> Array:
        """Return controls (nu,) that bring the plant to rest, wherever that is."""
        return self.nothing

    def calm(self, state: Array, slack: float) -> bool:
        """Whether it rests enough to ask for a plan; `slack` enlarges the limits, once it does."""
        return True

    @property
    def warning(self) -> str:
        """Say what keeps the commands from doing what is planned: their rate, or the limits."""
        beyond = '' if self.newest is None else beyond_limits(self.newest.trajectory, self.limits)
        return '; '.join(filter(None, [self.parameters.too_slow(self.growth_rate), beyond]))

    @property
    def found(self) -> dict[str, float]:
        """Return what the samples say of the plant, by name and unit."""
        return {'delay of commands [s]': self.estimator.delay}

    def observe(self, state: Array, stamp: float) -> None:
        """Take a measured state (nx,) of the instant `stamp` [s]; gains to be estimated are 1."""
        if self.estimator.stamp is not None and stamp <= self.estimator.stamp:
            return
        state = np.append(state, np.ones(self.estimator.size - state.size))
        try:
            with np.errstate(all='ignore'):
                self._repetition.observe(state, stamp, self.rest_slack)
                self.estimator.observe(state, stamp)
        except BREAKDOWN as error:
            self.estimator.reset()
            told = f'the estimate of the state broke down ({one_line(error)}) and begins anew'
            self._notice = told, stamp

    def state_age(self, now: float) -> float:
        """Age of the newest state [s]; infinite where there is none that can be believed."""
        stamp = None if self._repetition.stuck else self.estimator.stamp
        return math.inf if stamp is None else now - stamp

    @property
    def newest(self) -> Motion | None:
        """Return the active motion that was accepted last."""
        return self.pending or self.current

    def accept(self, trajectory: Trajectory, start: float, now: float) -> None:
        """Accept a trajectory at once, as `accepting` does."""
        finished(self.accepting(trajectory, start, now))

    def accepting(self, trajectory: Trajectory, start: float, now: float) -> Steps[None]:
        """
        Accept a trajectory whose motion begins at `start` [s]; until then it may be `pending`.

        One already under way is joined midway. The gains are computed here. After an abort a
        sensor that seems stuck is believed anew: the plant may have been held fast.

        Raise TrajectoryRejected if it lies in the past, or the state is too far from it. A tracker
        that has just been restarted into a plan recovers then, with `replan.on_deviation`.
        """
        if self.phase in (Phase.STOPPED, Phase.RECOVERING) and not self.braking:
            self._repetition = RepetitionWatch(self.estimator)
        try:
            check_trajectory(trajectory, start, now)
            with suppress(*BREAKDOWN):  # what cannot be predicted is compared at the start
                self._check_start(Motion(trajectory, start, None), now)
        except TrajectoryMissed as missed:
            lately = start <= now < start + trajectory.duration + _LATELY
            if self.phase is Phase.IDLE and lately and self.parameters.replan.on_deviation:
                self.abort(str(missed))
            raise
        self.pending = Motion(trajectory, start, (yield from self._prepared(trajectory)))
        if self.current is None:
            self._brakes = self.braking
            self.phase, self.reason = Phase.WAITING, ''

    def _prepared(self, trajectory: Trajectory) -> Steps[Any]:
        try:
            return (yield from self.prepare(trajectory))
        except BREAKDOWN as error:
            raise TrajectoryRejected(
                f'no feedback along the trajectory can be computed: {one_line(error)}'
            ) from error

    def _check_start(self, motion: Motion, now: float) -> None:
        """Compare the state expected at the start of `motion` with the planned one."""
        at, stale = max(motion.start, now), self.state_age(now) > self.parameters.state_timeout
        if stale or at - now > _LONGEST_FORESEEN:
            return  # compared at the start
        if self.current is not None or self.braking:
            expected = self._predicted_state(now, at)
        else:
            self.estimator.history.add(now, self.nothing)  # from now on
            expected = self.estimator.predict(at)
        self._compare(motion, expected, at)

    @property
    def braking(self) -> bool:
        """Whether the plant is being brought to rest, and goes on to be until a plan starts."""
        if self.phase is Phase.WAITING:
            return self._brakes
        return self.phase is Phase.RECOVERING and not self.wants_plan

    def _predicted_state(self, now: float, at: float) -> Array:
        """State (nx,) at the instant `at` [s] if this tracker goes on as it does."""
        time = min(now + self.estimator.delay, at)  # until then earlier commands act
        state = self.estimator.predict(time)
        # Held for much longer than an interval the feedback would not follow a quick swing.
        longest = max(2.0 * self.parameters.interval, (at - now) / _LOOK_AHEAD)
        while time < at - CLOCK_TOLERANCE:
            step = min(longest, at - time)
            state = self.estimator.move(state, self._going_on(time, state), step)
            time += step
        return state

    def _going_on(self, time: float, state: Array) -> Array:
        if self.current is None:
            return self.recover(state)
        tracking = self.phase is Phase.TRACKING and not self.captured(self.current, time, state)
        return (self.track if tracking else self.hold)(self.current, time, state).control

    def _compare(self, motion: Motion, state: Array, time: float) -> None:
        midway = time > motion.start + self.parameters.interval
        name, place = ('path', 'present point') if midway else ('start', 'start')
        error = self.error(state, motion.reference(time))
        if far := self._too_far(motion, error, f'trajectory at its {place}', name):
            raise TrajectoryMissed(far)

    def _too_far(self, motion: Motion, error: Array, what: str, name: str = 'path') -> str:
        """Tell that the tolerance `name` is exceeded, and by what; empty where it is not."""
        most = getattr(self.parameters.tolerance, name)
        if self.deviation(motion, error) <= most:
            return ''
        off = worst_state(self.plant, error, [self.deviation(motion, e) for e in np.diag(error)])
        return f'the state is away from the {what} by more than tolerance.{name} = {most:g}: {off}'

    def command(self, now: float) -> Command:
        """Return the command for the interval that begins now."""
        self._follow_clock(now)
        age = self.state_age(now)
        acts_at = now + self.estimator.delay
        if age > self.parameters.state_timeout:
            return self._nothing(now, self._stale(now, age))
        try:
            with np.errstate(all='ignore'):
                time = self._start_within(acts_at)
                state = self.estimator.predict(time)
                before = self._idle(state) if time > acts_at else self.nothing
                action = self._act(time, state)
                control = self._idle(state) if action is None else action.control
                share = (time - acts_at) / self.parameters.interval  # until the start
                control = share * before + (1.0 - share) * control
        except BREAKDOWN as error:  # the command is to be zero now, not when the node has died
            return self.break_down(now, one_line(error))
        if not np.isfinite(control).all():
            return self.break_down(now, 'a value is not a finite number')
        self.estimator.history.add(now, control)
        self.estimator.find_delay(self.phase is Phase.TRACKING)
        return Command(control, self.phase, action, self._noticed(now) or self.reason)

    def _noticed(self, now: float) -> str:
        """Tell what happened just now, for as long as a state may be old."""
        told, stamp = self._notice
        return told if now - stamp <= self.parameters.state_timeout else ''

    def _start_within(self, acts_at: float) -> float:
        """Return the start awaited, if it lies in the coming interval; else where that begins."""
        start = math.inf if self.current or self.pending is None else self.pending.start
        return start if acts_at < start < acts_at + self.parameters.interval else acts_at

    def _idle(self, state: Array) -> Array:
        if self.pending is not None:
            # A plan made while the plant moves reckons with what brings it to rest meanwhile.
            return self.recover(state) if self._brakes else self.wait(self.pending, state)
        if self.phase is Phase.RECOVERING:
            # Plans assume that nothing is commanded until they start.
            self.wants_plan = self.calm(state, _CALM_SLACK if self.wants_plan else 1.0)
            if not self.wants_plan:
                return self.recover(state)
        return self.nothing

    def break_down(self, now: float, what: str) -> Command:
        """Abort the motion, forget the state and command nothing; `what` says why."""
        self.stop(f'the feedback broke down: {what}')
        self.estimator.reset()
        return self._nothing(now, self.reason)

    def _nothing(self, now: float, problem: str) -> Command:
        self.estimator.history.add(now, self.nothing)
        return Command(self.nothing, self.phase, None, problem)

    def _stale(self, now: float, age: float) -> str:
        """Tell why there is no state that can be believed."""
        if self._repetition.stuck:
            return STUCK
        if math.isinf(age):
            return self._noticed(now) or self.reason or 'no state has been received yet'
        timeout = self.parameters.state_timeout
        return f'the newest state is older than state_timeout = {timeout:g} s'

    def is_set_back(self, now: float) -> bool:
        """Whether the clock, now at `now` [s], was set back since the last command."""
        return now < self._time - CLOCK_TOLERANCE

    def _follow_clock(self, now: float) -> None:
        if self.is_set_back(now):
            self.estimator.reset()
            self.estimator.history.clear()
            self._notice = '', -math.inf
            if self.phase is not Phase.IDLE:
                self.stop(f'the clock was set back by {self._time - now:.3g} s')
        self._time = now

    def _act(self, time: float, state: Array) -> Action | None:
        self._take_over(time, state)
        motion = self.current
        if motion is None:
            return None
        if self.phase is Phase.TRACKING:
            self.current = motion = self.paced(motion, time, state)
            if self.captured(motion, time, state):
                self.phase = Phase.HOLDING
        tracking = self.phase is Phase.TRACKING
        action = (self.track if tracking else self.hold)(motion, time, state)
        far = self._too_far(motion, action.error, 'trajectory' if tracking else 'goal')
        if not tracking and motion.reached is None:
            at_goal = self.at_goal(motion, state)
            if at_goal or time > motion.end + self.settling:
                self.current = motion = replace(motion, reached=at_goal)
            if motion.reached is False:
                self.reason = (
                    f'the goal was not reached {self.settling:.3g} s after the plan ended'
                )
                far = far or self.reason * self.parameters.replan.on_deviation
        if far:
            self.abort(far)
        return None if far else action

    def _take_over(self, time: float, state: Array) -> None:
        """Let a trajectory whose start has come take over."""
        motion = self.pending
        if motion is None or time < motion.start:
            return
        self.pending = None
        try:
            self._compare(motion, state, time)
        except TrajectoryRejected as refusal:
            if self.current is None:
                self.abort(str(refusal))
            else:
                self._notice = f'kept the active trajectory: {refusal}', time
            return
        self.current, self.phase, self.reason = motion, Phase.TRACKING, ''

    def adopt(self, other: TrajectoryTracker) -> None:
        """
        Go on from where another tracker of the same plant is, with gains that fit the parameters.

        Raise TrajectoryRejected if there are none for an active trajectory.
        """
        self.phase, self.reason, self._time = other.phase, other.reason, other._time
        given = self.parameters
        same = replace(other.parameters, tolerance=given.tolerance, replan=given.replan) == given
        self.current, self.pending = (
            m if m is None or same else replace(m, law=finished(self._prepared(m.trajectory)))
            for m in (other.current, other.pending)
        )
        self.wants_plan, self._brakes = other.wants_plan, other._brakes
        self._repetition = other._repetition.of(self.estimator)
        self.estimator.go_on_from(other.estimator, self.plant == other.plant)
        if self.phase is Phase.RECOVERING and not self.parameters.replan.on_deviation:
            self.stop(self.reason)

    def abort(self, reason: str) -> None:
        """Give the motion up; where a new plan is to be asked for, bring the plant to rest."""
        self.stop(reason)
        if self.parameters.replan.on_deviation:
            self.phase, self.wants_plan = Phase.RECOVERING, False

    def stop(self, reason: str) -> None:
        """Give the motion up: nothing is commanded until the next trajectory."""
        self.phase, self.reason = Phase.STOPPED, reason
        self.current = self.pending = None

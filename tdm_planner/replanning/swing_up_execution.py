# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A swing-up under its tracker's feedback, looked ahead to the end and beyond."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
import math

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.plants.pendulum_kernels import FeedbackTable, roll_feedback
from tdm_planner.problems.pendulum.problem import PendulumSwingUp
from tdm_planner.problems.pendulum.task import PENDULUM_NAME, PendulumStart
from tdm_planner.replanning.execution import (
    Execution,
    Observation,
    Outlook,
    Predicted,
    TimedPlan,
)
from tdm_planner.tracking.linear_quadratic import mean_controls, PlanLaw
from tdm_planner.tracking.motion import finished, ObservedPhase
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters

_SETTLING = 10.0  # natural periods / 2 pi that the look-ahead goes on after the end of the plan
_SLIP = 0.1  # of the time that passes, by which a plan may come to be late or early
_DISK_SLACK = 1.05  # of limits.disk_angle: tracking may take it a little beyond a planned limit


class SwingUpExecution(Execution):
    """
    The pendulum's tracker as a model of what it will do.

    `parameters` are the tracker's; where they are not known, the defaults with the problem's plant
    and limits.
    """

    def __init__(
        self, plan: TimedPlan, parameters: PendulumTrackerParameters | None = None
    ) -> None:
        super().__init__(plan)
        problem = plan.problem
        assert isinstance(problem, PendulumSwingUp)
        if parameters is None:
            parameters = PendulumTrackerParameters(plant=problem.plant, limits=problem.limits)
        self._plant, self._largest_angle = problem.plant, problem.limits.disk_angle
        self._tracker = PendulumTracker(parameters)
        self._late, self._seen = 0.0, plan.start  # of the plan [s], and when that was seen

    @cached_property
    def _law(self) -> PlanLaw:
        """Feedback along the plan."""
        return finished(self._tracker.prepare(self.plan.solution.trajectory))

    def predict(self, observations: Mapping[str, Observation], at: float) -> dict[str, Predicted]:
        """Roll the feedback law from the measured state to the instant `at`."""
        seen = observations[PENDULUM_NAME]
        if at <= seen.stamp:
            return {PENDULUM_NAME: Predicted(seen.state, np.zeros(1), seen.phase)}
        if seen.phase is ObservedPhase.FOLLOWING:
            self._look(seen.state, seen.stamp)
        table = self._table(seen.phase, seen.stamp, at)
        state, control = roll_feedback(self._plant, seen.state, table)[-1], np.zeros(1)
        if seen.phase is ObservedPhase.FOLLOWING:
            planned, elapsed = self.plan.solution.trajectory, self.plan.elapsed(at) - self._late
            reference = planned.sample(elapsed)
            # Sensors may report theta modulo 2 pi; `goal.turns` goes on from the plan's.
            state[0] = reference.state[0] + wrapped(state[0] - reference.state[0])
            if elapsed < planned.duration:
                control = reference.control
        return {PENDULUM_NAME: Predicted(state, control, seen.phase)}

    def outlook(self, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Roll the feedback law to the end of the plan and a while about upright."""
        plan, plant, now = self.plan, self._plant, predicted[PENDULUM_NAME]
        if now.phase is not ObservedPhase.FOLLOWING:
            return Outlook(failure='the active plan is not followed any more')
        left = max(plan.end - at, 0.0)
        goal = plan.solution.trajectory.states[-1]
        if self._tracker.capture_share(now.state, goal) < 1.0:
            return Outlook(left, settled=True)
        until = at + left + _SETTLING / plant.natural_frequency
        states = roll_feedback(plant, now.state, self._table(now.phase, at, until))
        if (
            not np.isfinite(states).all()
            or not self._tracker.capture_share(states[-1], goal) < 1.0
        ):
            return Outlook(left, failure='the feedback cannot bring it back to the active plan')
        limit = _DISK_SLACK * self._largest_angle
        furthest = float(np.abs(states[:, 1]).max())
        if furthest > max(limit, abs(float(now.state[1]))):
            return Outlook(left, failure=f'the disk would turn to {furthest:.3g} rad')
        return Outlook(left)

    def problem_from(
        self, problem: PendulumSwingUp, predicted: Mapping[str, Predicted]
    ) -> PendulumSwingUp:
        """Return the swing-up from the predicted state."""
        now, torque = predicted[PENDULUM_NAME], None
        if problem.method == 'smooth':  # without a jump, unless the limits are others now
            most = problem.task.planned_torque
            torque = min(max(float(now.control[0]), -most), most)
        theta, psi, theta_dot, psi_dot = now.state.tolist()
        return replace(problem, start=PendulumStart(theta, psi, theta_dot, psi_dot, torque))

    def _look(self, state: Array, at: float) -> None:
        """Look how late the plan is for its tracker, which lets it wait for the pendulum."""
        plan, law = self.plan, self._law
        elapsed = plan.elapsed(at) - self._late
        slip = _SLIP * (at - self._seen)
        if not 0.0 < slip < elapsed < plan.solution.duration - slip:
            return  # also where the state is older than the last: messages may overtake others
        first, last = law.places(np.array([elapsed - slip, elapsed + slip])).tolist()
        times = law.step * np.arange(first, last + 1)
        errors = state - law.trajectory.sample(times).state
        errors[:, 0] = wrapped(errors[:, 0])
        costs = law.costs[law.places(times), :4, :4]
        nearest = int(np.argmin(np.einsum('ki,kij,kj->k', errors, costs, errors)))
        if 0 < nearest < len(times) - 1:  # else it was pushed, and the plan goes on as it did
            planned = law.trajectory.sample(times[nearest])
            rates = self._plant.derivative(planned.state, planned.control)
            ahead = law.ahead(times[nearest], rates, errors[nearest])
            self._late, self._seen = plan.elapsed(at) - float(times[nearest]) - ahead, at

    def _table(self, phase: ObservedPhase, start: float, end: float) -> FeedbackTable:
        """Tabulate the law from instant to instant [s], its intervals at most the tracker's."""
        count = max(1, math.ceil((end - start) / self._tracker.parameters.interval * (1.0 - 1e-9)))
        step = (end - start) / count
        limit = self._tracker.parameters.limits.torque
        references, torques, gains = np.zeros((count, 4)), np.zeros(count), np.zeros((count, 4))
        if phase is ObservedPhase.RECOVERING:
            gains[:] = self._tracker.recovery_gain
        elif phase is ObservedPhase.FOLLOWING:
            law, begin = self._law, self.plan.elapsed(start) - self._late
            edges = np.asarray(begin + step * np.arange(count + 1), dtype=float)
            elapsed = edges[:-1]
            after = elapsed >= self.plan.solution.duration
            references = law.trajectory.sample(elapsed).state
            references[after, 2:] = 0.0
            torques = mean_controls(law.trajectory, edges)[:, 0]
            along = law.gains[law.places(elapsed), 0, :4]
            gains = np.where(after[:, None], self._tracker.upright.gain, along)
        return FeedbackTable(references, torques, gains, step, limit)

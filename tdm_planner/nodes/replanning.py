# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Replanning in the planner node: reviews at `replan.rate`, one at a time, beside the executor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.timer import Timer
from tdm_planner.exceptions import NoState
from tdm_planner.nodes.adapters import Adapter
from tdm_planner.nodes.motion_clock import pacing_clock
from tdm_planner.nodes.planning import Failure, Plan
from tdm_planner.nodes.worker import Worker
from tdm_planner.parameters import build
from tdm_planner.problems.base import Problem
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import PlanInForce, Replanner, Review
from tdm_planner.trajectory import NANOSECOND

LONGEST_PERIOD = 3600.0  # s between reviews, however low the rate
_WARNING_PERIOD = 5.0  # s, the least time between warnings of a kind


class Replanning:
    """
    Has the plan in force reviewed at a rate, and hands new plans to `publish`.

    `worker` is shared with the planner: while it solves a request, no review is made. Where
    nothing can be measured there is nothing to review a plan by.
    """

    def __init__(self, node: Node, worker: Worker, publish: Callable[[Plan], None]) -> None:
        self._node, self._worker, self._publish = node, worker, publish
        self._origin = int(node.get_clock().now().nanoseconds)
        self._timer: Timer | None = None
        self._replanner: Replanner | None = None
        self._reviewed: Plan | None = None
        self._trackers: Mapping[str, Any] = {}
        self._taken_over: PlanInForce | None = None
        self._question: tuple[Mapping[str, Any], Problem] | None = None
        self._reviewing = False
        self._waiting: Callable[[], None] | None = None
        self._period = object()  # of activity, to tell a review of an earlier one
        self._active = False
        self.plan: Plan | None = None
        self.adapter: Adapter | None = None
        self.values: Mapping[str, Any] = {}
        self.reviews = self.replans = 0
        self.last = ''

    @property
    def active(self) -> bool:
        """While it is not, no review begins, and one that is under way has no consequences."""
        return self._active

    @active.setter
    def active(self, active: bool) -> None:
        self._active, self._period = active, object()

    def clock_was_set(self, step: int) -> None:
        """Take note that instants of the node's clock are `step` [ns] more than they were."""
        self._origin += step

    def set_up(self, adapter: Adapter | None, values: Mapping[str, Any]) -> None:
        """Follow changed parameters; the timer is made anew where its rate has changed."""
        before, self.values, self.adapter = self.values, dict(values), adapter
        rate = values['replan.rate']
        if adapter is None or rate == before.get('replan.rate'):
            return
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        if rate > 0:
            self._timer = self._node.create_timer(
                min(1.0 / rate, LONGEST_PERIOD), self._on_timer, clock=pacing_clock(self._node)
            )

    @property
    def yields(self) -> bool:
        """Whether it is only a review that keeps the worker, and no request waits for its end."""
        return self._reviewing and self._waiting is None

    def when_free(self, request: Callable[[], None]) -> None:
        """Call `request` now, or when the review under way has ended."""
        if self._reviewing:
            self._waiting = request
        else:
            request()

    def figures(self) -> dict[str, Any]:
        """Return what the diagnostics show."""
        if self._timer is None:
            return {}
        return {'reviews': self.reviews, 'replans': self.replans, 'last review': self.last}

    def _seconds(self, instant: int) -> float:
        """Instant [s]: small numbers keep their nanoseconds in a float."""
        return (instant - self._origin) * NANOSECOND

    def _on_timer(self) -> None:
        plan, adapter, values = self.plan, self.adapter, self.values
        if not self.active or plan is None or adapter is None or self._worker.busy:
            return
        if not adapter.replans:
            return
        now = int(self._node.get_clock().now().nanoseconds)
        inactive = adapter.inactive if plan.start <= now else []
        if inactive:
            self._rest(f'no replanning: no tracker is active for {", ".join(inactive)}')
            return
        try:
            observations = adapter.observations(values, now, self._seconds)
        except NoState as error:
            self.last = f'{error.code}: {error}'
            self._node.get_logger().warning(
                f'no replanning: {error}', throttle_duration_sec=_WARNING_PERIOD
            )
            return

        def job() -> Review | Failure:
            try:
                replanner = self._replanner_of(plan, adapter, values)
                return replanner.review(
                    self._asked(plan, values), observations, self._seconds(now)
                )
            except Exception as error:  # noqa: B902
                return Failure.of(error)

        self._reviewing, period = True, self._period

        def done(review: Review | Failure) -> None:
            self._reviewing = False
            self.reviews += 1
            if self._period is not period:
                self.last = 'deactivated meanwhile'
            elif self.plan is not plan:
                self.last = 'another plan came into force meanwhile'
            else:
                self._on_review(review)
            waiting, self._waiting = self._waiting, None
            if waiting is not None:
                waiting()

        self._worker.submit(job, done)

    def _rest(self, reason: str) -> None:
        """Review nothing, and say so once."""
        if self.last != reason:
            self.last = reason
            self._node.get_logger().warning(reason)

    def _replanner_of(self, plan: Plan, adapter: Adapter, values: Mapping[str, Any]) -> Replanner:
        """Return the replanner for the plan in force, made anew for every plan."""
        parameters = build(ReplanParameters, values, 'replan.')
        replanner, trackers = self._replanner, adapter.tracker_parameters
        if replanner is None or self._reviewed is not plan:
            earlier = () if replanner is None else replanner.history
            execution = adapter.execution(plan.problem)
            replanner = self._replanner = Replanner(execution, parameters)
            made = self._taken_over
            if made is None or made.solution is not plan.solution:
                made = PlanInForce(plan.problem, plan.solution, self._seconds(plan.start))
            replanner.adopt(made, earlier)
            self._reviewed, self._trackers = plan, trackers
        elif trackers != self._trackers:
            replanner.execution, self._trackers = adapter.execution(plan.problem), trackers
        replanner.parameters = parameters
        return replanner

    def _asked(self, plan: Plan, values: Mapping[str, Any]) -> Problem:
        """Return the problem that the parameters ask, from the start of the plan in force."""
        if self._question is None or self._question[0] is not values:
            self._question = (
                values,
                type(plan.problem).from_parameters({**values, **self._starts(plan)}),
            )
        return self._question[1]

    @staticmethod
    def _starts(plan: Plan) -> dict[str, Any]:
        # What start.* says is no matter here: it must not make the question an invalid one.
        parameters = plan.problem.to_parameters()
        return {name: value for name, value in parameters.items() if 'start.' in name}

    def _on_review(self, outcome: Review | Failure) -> None:
        if isinstance(outcome, Failure):
            self.last = f'{outcome.code}: {outcome.reason}'
            self._node.get_logger().error(
                f'no replanning: {self.last}\n{outcome.trace}'.rstrip(),
                throttle_duration_sec=_WARNING_PERIOD,
            )
        else:
            self.last = outcome.reason
            self._take_over(outcome)

    def _take_over(self, review: Review) -> None:
        if review.refused:
            self._node.get_logger().warning(
                f'the last plan was not taken over by {", ".join(review.refused)}: the one before '
                'is still followed',
                throttle_duration_sec=_WARNING_PERIOD,
            )
        if review.plan is None:
            if review.necessary:
                self._node.get_logger().warning(
                    f'the plan in force fails, no other was found: {review.reason}',
                    throttle_duration_sec=_WARNING_PERIOD,
                )
            return
        start = self._origin + round(review.plan.start / NANOSECOND)
        late = (int(self._node.get_clock().now().nanoseconds) - start) * NANOSECOND
        if late > 0.0:
            self.last = f'a new plan came {late:.3f} s late'
            self._node.get_logger().warning(
                f"{self.last}: raise 'replan.delay'", throttle_duration_sec=_WARNING_PERIOD
            )
            return
        self.replans += 1
        self._taken_over = review.plan
        self._node.get_logger().info(f'new plan: {review.reason}')
        self._publish(Plan(review.plan.problem, review.plan.solution, start))

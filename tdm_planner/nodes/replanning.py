# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Replanning in the planner node: reviews at `replan.rate`, one at a time, beside the executor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.timer import Timer
from tdm_planner.exceptions import Failure, NoState
from tdm_planner.nodes.adapter import Adapter
from tdm_planner.nodes.clocks import MotionClock, pacing_clock
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.plan_queue import PlanQueue
from tdm_planner.parameters import build
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import ActivePlan, Replanner, Review

LONGEST_PERIOD = 3600.0  # s between reviews, however low the rate
_SELDOM: Mapping[str, Any] = {'throttle_duration_sec': 5.0}  # of a kind


class Replanning:
    """
    Reviews the active plan at a rate, and hands new plans to `publish`.

    A plan is reviewed for the node's present parameters, except those that were given for this
    plan alone (`ActivePlan.own`). Problems without a measured state are not reviewed. Instants are
    those of `clock` [s].
    """

    def __init__(
        self,
        node: ManagedNode,
        clock: MotionClock,
        queue: PlanQueue,
        adapter: Adapter,
        publish: Callable[[ActivePlan], None],
    ) -> None:
        self._node, self._clock, self._queue, self._publish = node, clock, queue, publish
        self._adapter = adapter
        self._rate = 0.0  # Hz
        self._timer: Timer | None = None
        self._plan: ActivePlan | None = None
        self._replanner: Replanner | None = None
        self._reviewed: ActivePlan | None = None
        self._trackers: Mapping[str, Any] = {}
        self._asked: tuple[Mapping[str, Any], ActivePlan, Problem] | None = None
        self._reviews = self._replans = 0
        self._last = ''
        self.values_changed()

    def values_changed(self) -> None:
        """Review at the rate that the node's parameters say from now on."""
        rate = self._node.parameter_values['replan.rate']
        if rate == self._rate:
            return
        self._rate = rate
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        if rate > 0:
            self._timer = self._node.create_timer(
                min(1.0 / rate, LONGEST_PERIOD), self._on_timer, clock=pacing_clock(self._node)
            )

    def follow(self, plan: ActivePlan | None) -> None:
        """Review this plan from now on; drop the outcome of a review under way."""
        self._plan = plan
        self._queue.drop_review()

    def figures(self) -> dict[str, Any]:
        """Return what the diagnostics show."""
        if self._timer is None:
            return {}
        return {'reviews': self._reviews, 'replans': self._replans, 'last review': self._last}

    def _on_timer(self) -> None:
        plan, adapter = self._plan, self._adapter
        if not self._node.active or plan is None or not adapter.measures:
            return
        values = {**self._node.parameter_values, **plan.own}
        now = self._clock.now()
        inactive = adapter.inactive if plan.start <= now else []
        if inactive:
            reason = f'no replanning: no tracker is active for {", ".join(inactive)}'
            if self._last != reason:
                self._last = reason
                self._node.get_logger().warning(reason)
            return
        try:
            observations = adapter.observations(values, now)
        except NoState as error:
            self._last = f'{error.code}: {error}'
            self._node.get_logger().warning(f'no replanning: {error}', **_SELDOM)
            return

        def review() -> Review:
            replanner = self._replanner_of(plan, values)
            return replanner.review(self._problem(plan, values), observations, now)

        self._queue.review(review, self._on_review)

    def _replanner_of(self, plan: ActivePlan, values: Mapping[str, Any]) -> Replanner:
        """Return the replanner, for the plan, its trackers and parameters as they are now."""
        parameters = build(ReplanParameters, values, 'replan.')
        adapter = self._adapter
        trackers = {**adapter.tracker_parameters, '': parameters.deviation}
        adopted = self._reviewed is plan
        if self._replanner is None:
            self._replanner = Replanner(adapter.execution(plan.problem), parameters)
        elif not adopted or trackers != self._trackers:
            self._replanner.execution = adapter.execution(plan.problem)
        if not adopted:
            self._replanner.adopt(plan)
        self._reviewed, self._trackers = plan, trackers
        self._replanner.parameters = parameters
        return self._replanner

    def _problem(self, plan: ActivePlan, values: Mapping[str, Any]) -> Problem:
        """Return the problem that the parameters state, from the start of the active plan."""
        if self._asked is None or self._asked[1] is not plan or self._asked[0] != values:
            # Ignore start.*: it must not make the problem invalid.
            own = plan.problem.to_parameters()
            starts = {name: value for name, value in own.items() if 'start.' in name}
            made = type(plan.problem).from_parameters({**values, **starts})
            self._asked = (values, plan, made)
        return self._asked[2]

    def _on_review(self, outcome: Review | Exception) -> None:
        self._reviews += 1
        logger = self._node.get_logger()
        if isinstance(outcome, Exception):
            failure = Failure.of(outcome)
            self._last = f'{failure.code}: {failure.reason}'
            logger.error(f'no replanning: {failure}', **_SELDOM)
            return
        self._last = outcome.reason
        if outcome.rejected:
            kept = ', '.join(outcome.rejected)
            logger.warning(
                f'the last plan was rejected by {kept}: the one before is still followed',
                **_SELDOM,
            )
        if outcome.plan is None:
            if outcome.necessary:
                logger.warning(
                    f'the active plan fails and there is no new one: {outcome.reason}', **_SELDOM
                )
        elif (late := self._clock.now() - outcome.plan.start) > 0.0:
            self._last = f'a new plan came {late:.3f} s late'
            logger.warning(f"{self._last}: raise 'replan.delay'", **_SELDOM)
        else:
            self._replans += 1
            logger.info(f'new plan: {self._last}')
            self._publish(outcome.plan)

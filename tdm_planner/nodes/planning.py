# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the planner computes beside its executor: plans on request, reviews of the active plan."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
import threading
import time
from typing import Any

from rclpy.node import Node
from rclpy.timer import Timer
from tdm_planner.exceptions import (
    Busy,
    DeadlineExceeded,
    Failure,
    Infeasible,
    InvalidProblem,
    NoState,
    TdmError,
    VerificationFailed,
)
from tdm_planner.nodes.adapter import Adapter
from tdm_planner.nodes.clocks import MotionClock, NO_TIME, pacing_clock
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.tracker_plans import Recovery
from tdm_planner.parameters import build
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.execution import Observation, TimedPlan
from tdm_planner.replanning.planned_plants import Values
from tdm_planner.replanning.replanner import Replanner, Review

_SHARES = (1.0, 0.5, 0.25)  # of `start.delay`, after which a motion may begin
_SHORTEST = 0.01  # s; with less time left it is not tried again
_PREPARING = 0.5  # share of `start.delay` that is left when a plan is ready
_MARGIN = 0.1  # s that checking and publishing a plan may take
_POLL_PERIOD = 0.002  # s between looks at what is waited for
_TRACKER_WAIT = 0.75  # s, the longest wait for trackers that are there to say what they follow
_FIRST_STATE_WAIT = 10.0  # s, the longest wait for a first state: BUSY is answered meanwhile
_LONGEST_PERIOD = 3600.0  # s between reviews, however low the rate
_SELDOM: Mapping[str, Any] = {'throttle_duration_sec': 5.0}  # of a kind


@dataclass(eq=False)
class _Job:
    kind: str
    compute: Callable[[], Any]
    done: Callable[[Any], None]
    dropped: bool = False  # its outcome is of no use any more


class PlanQueue:
    """
    Runs `compute()` in a daemon thread and calls `done(outcome)` in the node's executor.

    The outcome is what `compute` returns, or the exception it raised. One computation runs at a
    time, and cannot be interrupted; a daemon, lest it keep the process from ending. Methods are
    called in callbacks of the executor.

    preparation   before all else: of the problem, of the plan along which a request is planned
    request       next; while one waits or is being solved, another is Busy
    review        only when there is nothing else to do; a request supersedes it
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._running: _Job | None = None
        self._waiting: deque[_Job] = deque()

    @property
    def solving(self) -> bool:
        """Whether a request waits or is being solved."""
        return any(job.kind == 'request' for job in self._jobs)

    def request(self, compute: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Solve a request next; raise Busy while there is another."""
        if self.solving:
            raise Busy('a request is being solved: ask again when it is answered')
        self.drop_review()
        self._waiting.append(_Job('request', compute, done))
        self._next()

    def prepare(self, compute: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Compute something before a request that waits."""
        self._waiting.appendleft(_Job('preparation', compute, done))
        self._next()

    def review(self, compute: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Review the active plan, if there is nothing else to do."""
        if not self._jobs:
            self._waiting.append(_Job('review', compute, done))
            self._next()

    def drop_review(self) -> None:
        """Drop the outcome of a review under way: it is of a plan that is not active any more."""
        if self._running is not None and self._running.kind == 'review':
            self._running.dropped = True

    def cancel(self, error: TdmError) -> None:
        """Drop everything; a request that is not answered yet is done with `error`."""
        pending = [job for job in self._jobs if not job.dropped]
        self._waiting.clear()
        for job in pending:
            job.dropped = True
            if job.kind == 'request':
                job.done(error)

    @property
    def _jobs(self) -> list[_Job]:
        return [*filter(None, [self._running]), *self._waiting]

    def _next(self) -> None:
        if self._running is None and self._waiting:
            job = self._running = self._waiting.popleft()
            threading.Thread(
                target=self._run, args=(job,), name='tdm_planner worker', daemon=True
            ).start()

    def _run(self, job: _Job) -> None:
        try:
            outcome = job.compute()
        except Exception as error:  # noqa: B902
            outcome = error
        except BaseException as error:  # noqa: B902 - a problem of the user's calls sys.exit
            outcome = RuntimeError(f'{type(error).__name__} ended the computation')
            outcome.__cause__ = error
        executor = self._node.executor
        if executor is not None:  # None: the node is being destroyed
            executor.create_task(self._deliver, job, outcome)

    def _deliver(self, job: _Job, outcome: Any) -> None:
        self._running = None
        if not job.dropped:
            job.done(outcome)
        self._next()


# Requests.


def make_plan(
    problem_class: type[Problem], values: Values, adapter: Adapter, clock: MotionClock
) -> TimedPlan:
    """
    Plan for the parameters `values` (the problem's and the request's), at the present of `clock`.

    From a measured state, plan for an earlier start than `start.delay` if that is infeasible: a
    plant in motion may have left its limits by then.

    Raise TdmError saying why there is no plan.
    """
    measured = values['start.source'] == 'measured' and bool(adapter.kind.state_names)
    if measured:
        _await_first_state(adapter, values['start.max_age'], clock)
    if not clock.runs:
        raise NoState(NO_TIME)
    failure: TdmError | None = None
    now = _wait_for_pending_start(adapter, values, clock) if measured else clock.now()
    delays = [share * values['start.delay'] for share in _SHARES]
    starts = [now + delay for delay in delays]
    for delay, start, sooner in zip(delays, starts, [*starts[1:], None], strict=True):
        try:
            begin = adapter.measured_start(values, clock.now(), start) if measured else {}
            problem = problem_class.from_parameters({**values, **begin})
            left = problem.solver.deadline
            if failure is not None:
                left = min(left, _time_until(start, sooner, clock.now()))
                if left < _SHORTEST:
                    break
            solution = problem.solve(deadline=left)
            if failure is not None:
                told = f'begins {delay:g} s ahead, as there is no plan for start.delay'
                solution = replace(solution, summary=f'{solution.summary}; {told}')
            # Solving may have left too little time.
            if not measured or adapter.may_start_later(now, start):
                start = max(start, clock.now() + _PREPARING * delay)
            return TimedPlan(problem, solution, start)
        except (DeadlineExceeded, VerificationFailed, NoState):  # a sooner start mends none
            if failure is None:
                raise
        except (InvalidProblem, Infeasible) as error:
            if not measured:
                raise
            failure = failure or _with_prediction_note(error, delay)
    assert failure is not None
    raise failure


def await_trackers(recovery: Recovery) -> None:
    """Wait until the trackers have said what they follow, but not for long."""
    _wait(lambda: not recovery.due, _TRACKER_WAIT)


def _await_first_state(adapter: Adapter, max_age: float, clock: MotionClock) -> None:
    """Wait at most `max_age` s for simulated time and states; NoState names what is missing."""
    longest = min(max_age, _FIRST_STATE_WAIT)
    _wait(lambda: clock.runs and not adapter.missing(), longest)
    missing = adapter.missing()
    if missing and clock.runs:
        limit = ' (start.max_age)' if longest == max_age else ', the longest that a request waits'
        raise NoState(f'{"; ".join(missing)} within {longest:g} s{limit}')


def _time_until(start: float, sooner: float | None, now: float) -> float:
    """Time [s] to plan what begins at `start`; half is left for what may begin `sooner`."""
    half = 0.0 if sooner is None else 0.5 * (sooner - now)
    return half if half >= _SHORTEST else start - now


def _wait_for_pending_start(adapter: Adapter, values: Values, clock: MotionClock) -> float:
    """Return the instant to plan at [s]: the present, or the start of a plan that begins soon."""
    # From that start on the plant follows the pending plan; until then, the one before.
    now = clock.now()
    begins = adapter.pending_start(now)
    longest = max(values['solver.deadline'], _SHARES[1] * values['start.delay']) + _MARGIN
    if begins is None or begins - now > longest:
        return now
    _wait(lambda: clock.now() >= begins, 2.0 * longest)  # simulated time may stand still
    return clock.now()


def _wait(until: Callable[[], bool], longest: float) -> None:
    """Look again and again, for `longest` s at most."""
    end = time.monotonic() + longest
    while not until() and time.monotonic() < end:
        time.sleep(_POLL_PERIOD)


def _with_prediction_note(error: TdmError, delay: float) -> TdmError:
    """Return the error; if it names the start, note that the start was predicted."""
    text = str(error)
    if 'start' in text:
        text += f' (as predicted from the measured state for {delay:g} s later, start.delay)'
    return type(error)(text)


# Reviews.


class Replanning:
    """
    Reviews the active plan at a rate, and hands new plans to `publish`.

    A plan is reviewed for the node's present parameters, except those that were given for it alone
    (`TimedPlan.request_parameters`). Problems without a measured state are not reviewed.
    """

    def __init__(
        self,
        node: ManagedNode,
        clock: MotionClock,
        queue: PlanQueue,
        adapter: Adapter,
        publish: Callable[[TimedPlan], None],
    ) -> None:
        self._node, self._clock, self._queue, self._publish = node, clock, queue, publish
        self._adapter = adapter
        self._rate = 0.0  # Hz
        self._timer: Timer | None = None
        self._replanner: Replanner | None = None
        self._made_for: Any = None  # the plan, its trackers' parameters, the reviews'
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
            period, clock = min(1.0 / rate, _LONGEST_PERIOD), pacing_clock(self._node)
            self._timer = self._node.create_timer(period, self._on_timer, clock=clock)

    def figures(self) -> dict[str, Any]:
        """Return what the diagnostics show."""
        if self._timer is None:
            return {}
        return {'reviews': self._reviews, 'replans': self._replans, 'last review': self._last}

    def _on_timer(self) -> None:
        adapter, newest, now = self._adapter, self._adapter.plans.newest, self._clock.now()
        if newest is None or not (self._node.active and adapter.kind.state_names):
            return
        vehicles, longest = adapter.vehicles, self._node.parameter_values['start.max_age']
        inactive = [name for name, v in vehicles.items() if v.tracker.inactive]
        if inactive and newest.start <= now:
            reason = f'no replanning: no tracker is active for {", ".join(inactive)}'
            if self._last != reason:
                self._last = reason
                self._node.get_logger().warning(reason)
            return
        try:
            observations = adapter.of_all(lambda vehicle: vehicle.seen(now, longest))
        except NoState as error:
            self._last = f'{error.code}: {error}'
            self._node.get_logger().warning(f'no replanning: {error}', **_SELDOM)
            return
        plan, failure = adapter.plans.reviewed(observations, now)
        if plan is None:
            self._last = failure
            return
        values = {**self._node.parameter_values, **plan.request_parameters}
        review = partial(self._review, plan, values, observations, now, failure)
        self._queue.review(review, self._on_review)

    def _review(
        self,
        plan: TimedPlan,
        values: Values,
        observations: Mapping[str, Observation],
        now: float,
        failure: str,
    ) -> Review:
        """Review a plan for the parameters `values`, see `Replanner`; in the queue's thread."""
        # Ignore start.*: it must not make the problem invalid.
        problem, own = plan.problem, plan.problem.to_parameters()
        asked = {**values, **{name: own[name] for name in own if 'start.' in name}}
        if any(asked.get(name) != value for name, value in own.items()):
            problem = type(problem).from_parameters(asked)
        return self._replanner_of(plan, values).review(problem, observations, now, failure)

    def _replanner_of(self, plan: TimedPlan, values: Values) -> Replanner:
        """Return the replanner, for the plan, its trackers and parameters as they are now."""
        parameters, adapter = build(ReplanParameters, values, 'replan.'), self._adapter
        trackers = {name: vehicle.tracker.parameters for name, vehicle in adapter.vehicles.items()}
        made_for = plan, trackers, parameters
        if self._replanner is None or made_for != self._made_for:
            execution = adapter.plant.execution(plan, trackers, values)
            self._replanner, self._made_for = Replanner(execution, parameters), made_for
        return self._replanner

    def _on_review(self, outcome: Review | Exception) -> None:
        self._reviews += 1
        logger = self._node.get_logger()
        if isinstance(outcome, Exception):
            failure = Failure.of(outcome)
            self._last = f'{failure.code}: {failure.reason}'
            logger.error(f'no replanning: {failure}', **_SELDOM)
            return
        self._last = outcome.reason
        if outcome.plan is None:
            if outcome.necessary:
                logger.warning(f'no new plan, the active one stays: {outcome.reason}', **_SELDOM)
        elif (late := self._clock.now() - outcome.plan.start) > 0.0:
            self._last = f'a new plan came {late:.3f} s late'
            logger.warning(f"{self._last}: raise 'replan.delay'", **_SELDOM)
        else:
            self._replans += 1
            logger.info(f'new plan: {self._last}')
            self._publish(outcome.plan)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `planner`: plans on request, publishes verified plans, and reports why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
import gc
import sys
from typing import Any

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.clock import TimeJump
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.exceptions import Busy, Failure, Inactive, InvalidProblem, NoState
from tdm_planner.nodes.adapter import Adapter
from tdm_planner.nodes.clocks import MotionClock, steady_timer, watch_set_back
from tdm_planner.nodes.diagnostics import PublisherCount, Report
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.planning import await_trackers, make_plan, PlanQueue, Replanning
from tdm_planner.nodes.reading import Level
from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.services import create_plan_service, Request
from tdm_planner.nodes.tracker_plans import Recovery
from tdm_planner.parameters import specifications
from tdm_planner.plants.compilation import report_compilation
from tdm_planner.problems.planner_parameters import PlannerParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.plan_reports import plan_answer, plan_figures, plan_summary

_NODE_PARAMETERS = specifications(PlannerParameters)
_PERIOD = 0.1  # s between looks whether the time of day was set
_GRACE = 0.3  # s from a plan's start until trackers must have reported that they follow it
_SUMMARY = 'plan_summary'


class Planner(ManagedNode):
    """
    Plans for the problem that the parameter `problem` names.

    Services `plan` (std_srvs/Trigger) and `plan_with` (rcl_interfaces/SetParametersAtomically)
    answer with one line of JSON. Solving runs beside the executor, see `PlanQueue`: states,
    parameters and further requests are served meanwhile. The `Adapter` reads the measured state
    and publishes plans.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('planner', 'planning', _NODE_PARAMETERS, **options)
        self._problem_class: type[Problem] = load_problem(self.parameter_values['problem'])
        self._queue, self._time = PlanQueue(self), MotionClock(self, self._on_clock_step)
        specified = self._problem_class.parameter_specifications
        # Which parameters exist may depend on those given at the start, as the robots' names are.
        given = {name: self.initial_value(spec) for name, spec in specified({}).items()}
        self.declare(specified(given))
        self.warn_of_unknown_overrides()
        self._failure: Failure | None = None
        self._expected: tuple[int, float] | None = None  # start [ns, s] of a plan not followed yet
        self._unfollowed = ''
        self._plan_id = self._requests = self._failures = 0
        self._prepared = False
        self._jumps = watch_set_back(self, self._on_simulated_jump)
        self.bring_up()

    # Lifecycle and parameters.

    def configure(self) -> None:
        """Connect the problem, and begin to prepare it."""
        self._summary = self.create_publisher(String, _SUMMARY, LATCHED)
        changed = self._diagnostics.update
        harm = 'trackers follow the plan that starts last; run only one of them'
        self._counts = [PublisherCount(self, _SUMMARY, harm, changed)]
        for kind, name in ((Trigger, 'plan'), (SetParametersAtomically, 'plan_with')):
            create_plan_service(self, kind, name, self._on_request)
        problem, values = self._problem_class, self.parameter_values
        self._adapter = Adapter(self, self._time, problem, values, self._on_request)
        if values['start.source'] == 'measured' and not self._adapter.kind.state_names:
            self.get_logger().warning(
                f'{problem.name} has no parameters start.<state>: plans begin at its stated '
                'start, whatever is measured'
            )
        for vehicle in self._adapter.vehicles.values():
            self._counts += vehicle.measured.count_sources(changed)
        assessed = self._adapter.kind.state_names and problem.assess is not Problem.assess
        recoverable = self._adapter.vehicles if assessed else {}
        trackers = {name: vehicle.tracker for name, vehicle in recoverable.items()}
        self._recovery = Recovery(self, self._adapter.kind, trackers)
        publish = partial(self._publish_or_report, Request())
        self._replanning = Replanning(self, self._time, self._queue, self._adapter, publish)
        steady_timer(self, _PERIOD, self._on_timer)
        if not self._prepared:  # begun once the executor runs
            self._first = steady_timer(self, 0.0, self._on_first)

    def activate(self) -> None:
        """Serve requests from now on, and go on to review the active plan."""
        self._failure = None
        self._adapter.values_changed(self.parameter_values)

    def deactivate(self) -> None:
        """Reject the requests that are not answered yet; what is being solved is dropped."""
        self._queue.cancel(Inactive('the planner was deactivated before there was a plan'))

    def cleanup(self) -> None:
        """Forget the active plan: its topics are gone."""
        self._expected, self._failure, self._unfollowed = None, None, ''

    def values_changed(self) -> None:
        """Let changed parameters act from the next request on."""
        if self.configured:
            self._adapter.values_changed(self.parameter_values)
            self._replanning.values_changed()
        super().values_changed()
        self._diagnostics.update()

    def _on_first(self) -> None:
        self.destroy_timer(self._first)
        report_compilation(self.get_logger().info)
        self._queue.prepare(self._prepare, lambda _: self._diagnostics.update())

    def _prepare(self) -> None:
        """Prepare what does not depend on a request; in the queue's thread."""
        try:
            self._problem_class.from_parameters({}).prepare()
            gc.freeze()  # exempt loaded modules from garbage collection, see `run`
            self.get_logger().info(f'ready to plan for {self._problem_class.name}')
        except Exception as error:  # noqa: B902
            # The first request fails in the same way, and its answer gives the reason.
            self.get_logger().error(f'preparing the problem failed: {Failure.of(error)}')
        self._prepared = True

    # Requests. Every one passes _on_request, PlanQueue.request, _next and _run, make_plan,
    # PlanQueue._deliver, _publish_or_report, Adapter.publish.

    def _on_request(self, request: Request, parameters: Sequence[Any] = ()) -> None:
        """Queue a request, with `parameters` of its own, or reject it with the reason."""
        self._requests += 1
        try:
            if not self.active:
                raise Inactive(
                    "the planner is inactive: 'ros2 lifecycle set "
                    f"{self.get_fully_qualified_name()} activate' lets it plan"
                )
            if parameters:
                request = replace(request, changes=self._own_parameters(parameters))
            values = {**self.parameter_values, **request.changes}
            self._recover()
            if self._recovery.due and not self._queue.solving:
                self._queue.prepare(partial(await_trackers, self._recovery), self._recover)
            self._queue.request(
                partial(make_plan, self._problem_class, values, self._adapter, self._time),
                partial(self._publish_or_report, request),
            )
            self._diagnostics.update()
        except (Busy, Inactive) as error:
            if request.answer is not None:
                request.answer(Failure.of(error))
        except Exception as error:  # noqa: B902
            self._publish_or_report(request, error)

    def _own_parameters(self, messages: Sequence[Any]) -> dict[str, Any]:
        """Return the parameters of a request, checked like the node's own."""
        try:
            given = [Parameter.from_parameter_msg(message) for message in messages]
        except (TypeError, ValueError) as error:
            raise InvalidProblem(f'the parameters cannot be read: {error}') from None
        own, names = self.checked(given), [item.name for item in given]
        if len(own) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidProblem(
                f"parameter '{twice}' is given twice in the request: must be once"
            )
        if reviews := [name for name in own if name.startswith('replan.')]:
            raise InvalidProblem(
                f"parameter '{reviews[0]}' cannot be part of a request: set it on the planner"
            )
        values = {**self.parameter_values, **own}
        vehicles = self._adapter.vehicles.values()
        unused = [name for v in vehicles for name in v.start_parameters if name in own]
        if unused and values['start.source'] == 'measured':
            raise InvalidProblem(
                f"parameter '{unused[0]}' has no effect while start.source = measured: the "
                "request must set 'start.source' to parameters"
            )
        return own

    def _publish_or_report(self, request: Request, outcome: TimedPlan | Exception) -> None:
        """Publish a plan, or keep the active one and say why there is no new one."""
        answer: str | Failure = ''
        try:
            if isinstance(outcome, Exception):
                raise outcome
            plan = outcome
            if request.lasting:
                changes = [Parameter(n, value=v) for n, v in request.changes.items()]
                result = self.set_parameters_atomically(changes)
                if not result.successful:
                    raise InvalidProblem(result.reason)
            else:
                plan = replace(
                    outcome, request_parameters={**outcome.request_parameters, **request.changes}
                )
            stamp = self._time.stamp(plan.start)
            self._adapter.publish(plan, stamp)
            self._recovery.end()
            self._plan_id += 1
            self._failure = None
            self._follow((stamp, plan.start))
            self._summary.publish(String(data=plan_summary(plan, self._plan_id, stamp)))
            self.get_logger().info(f'plan {self._plan_id}: {plan.solution.summary}')
            if request.answer is not None:
                answer = plan_answer(plan, self._plan_id)
                self._warn(plan)
        except Exception as error:  # noqa: B902
            answer = self._failure = Failure.of(error)
            self._failures += 1
            # Two calls: rclpy forbids a call site to change its severity.
            if answer.trace:
                self.get_logger().error(f'{request.title}: {answer}')
            else:
                self.get_logger().warning(f'{request.title}: {answer}')
        if request.answer is not None:
            request.answer(answer)
        self._diagnostics.update()

    def _warn(self, plan: TimedPlan) -> None:
        """Log what is not connected, and that a plan comes late."""
        warnings, late = self._adapter.warnings(), self._time.now() - plan.start
        if late > 0:
            warnings.append(
                f'plan {self._plan_id} is published {late:.3f} s after the start of its motion: '
                "raise 'start.delay' or lower 'solver.deadline'"
            )
        for sentence in warnings:
            self.get_logger().warning(sentence)

    # The active plan.

    def _follow(self, start: tuple[int, float] | None) -> None:
        """Expect trackers to follow the plan that starts then [ns, s]; None: none of ours."""
        self._expected, self._unfollowed = start, ''
        self._queue.drop_review()

    def _look_who_follows(self) -> None:
        """Name the trackers that do not follow the active plan once it has begun."""
        expected = self._expected
        if expected is None or self._time.now() - expected[1] < _GRACE:
            return
        self._expected, vehicles = None, self._adapter.vehicles.items()
        if names := [name for name, v in vehicles if v.tracker.rejects(expected[0])]:
            self._unfollowed = (
                f'plan {self._plan_id} is not followed by {", ".join(names)}: the tracker says why'
            )
            self.get_logger().warning(self._unfollowed)
            self._diagnostics.update()

    def _recover(self, _: Any = None) -> None:
        """Recover the plan that the trackers follow, if there is one."""
        # Before the first message on /clock no instant is known.
        ready = self.active and self._time.runs
        if self._adapter.plans.newest is not None or not (found := self._recovery.look(ready)):
            return

        def done(outcome: TimedPlan | Exception) -> None:
            if self._adapter.plans.newest is not None:
                return
            self._publish_or_report(Request(title='cannot recover the active plan'), outcome)
            if isinstance(outcome, TimedPlan):
                self.get_logger().info(f'recovered active plan {self._plan_id} from the trackers')

        values = self.parameter_values
        self._queue.prepare(partial(self._adapter.recovered, values, *found), done)

    # Time.

    def _on_timer(self) -> None:
        self._time.now()
        self._look_who_follows()
        self._recover()

    def _on_clock_step(self, step: float) -> None:
        self.get_logger().warning(f'the clock was set by {step:+.3g} s: the active plan goes on')
        if step < -_GRACE and self.configured:
            self._adapter.withdraw()

    def _on_simulated_jump(self, jump: TimeJump) -> None:
        """Drop the active plan when simulated time is set back, as the trackers do."""
        if not (self.get_clock().ros_time_is_active and self.configured):
            return
        self._queue.cancel(NoState('simulated time was set back before there was a plan'))
        if self._adapter.plans.newest is None:
            return
        self.get_logger().warning('simulated time was set back: the active plan is dropped')
        self._adapter.forget_plans()
        self._follow(None)

    # Diagnostics.

    def report(self) -> Report:
        """Return state, figures of the active plan, ages of the measured states."""
        now, plan = self._time.now(), self._adapter.plans.newest
        values: dict[str, Any] = {
            'problem': self.parameter_values['problem'],
            'requests': self._requests,
            'failures': self._failures,
            'plan id': self._plan_id,
            **({} if plan is None else plan_figures(plan, now)),
            **self._replanning.figures(),
        }
        for vehicle in self._adapter.vehicles.values():
            for name, age in vehicle.measured.ages(now).items():
                values[f'age of {name} [s]'] = 'never received' if age is None else age
        return Report(*self._state(), values)

    def _state(self) -> tuple[Level, str]:
        if self._queue.solving:
            return Level.OK, 'planning'
        if self._failure is not None:
            level = Level.ERROR if self._failure.trace else Level.WARN
            return level, f'{self._failure.code}: {self._failure.reason}'
        several = [count.warning for count in self._counts]
        if told := [*filter(None, [self._time.problem, *several, self._unfollowed])]:
            return Level.WARN, '; '.join(told)
        if not self._prepared:
            return Level.OK, 'preparing'
        if self._adapter.plans.newest is None:
            return Level.OK, 'ready'
        return Level.OK, f'plan {self._plan_id} active'


main = partial(run, Planner)

if __name__ == '__main__':
    sys.exit(main())

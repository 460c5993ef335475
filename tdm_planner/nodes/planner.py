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

"""Node `planner`: plans on request, publishes what was verified, says why where there is none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import gc
import sys
import threading
from types import MappingProxyType
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.exceptions import Busy, Inactive, InvalidProblem
from tdm_planner.nodes.adapters import Adapter, adapter_class
from tdm_planner.nodes.deferred_service import Answer, DeferredService
from tdm_planner.nodes.diagnostics import Level, Report
from tdm_planner.nodes.managed import ManagedNode
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.motion_clock import MotionClock, ros_clock
from tdm_planner.nodes.other_planners import OtherPlanners
from tdm_planner.nodes.other_planners import TOPIC as SUMMARY
from tdm_planner.nodes.planning import (
    Failure,
    make_plan,
    Plan,
    plan_answer,
    plan_figures,
    plan_summary,
)
from tdm_planner.nodes.recovery import Recovery
from tdm_planner.nodes.replanning import Replanning
from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.worker import Worker
from tdm_planner.parameters import specifications
from tdm_planner.plants.compilation import tell_of_compilation
from tdm_planner.problems.base import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.problems.request import RequestParameters
from tdm_planner.trajectory import NANOSECOND, Trajectory

_REQUEST = specifications(RequestParameters)
_NO_CHANGES: Mapping[str, Any] = MappingProxyType({})
_CLOCK_PERIOD = 0.1  # s between looks whether the time of day was set
_GRACE = 0.3  # s from a plan's start until trackers must have told that they follow it
_SUPERSEDED = "another planner's plan is in force"
_BUSY = 'a request is being solved: ask again when it is answered'

_Reply = Callable[['Plan | Failure'], None]


def _nobody(outcome: Plan | Failure) -> None:
    """Take the answer to a request that nobody waits for."""


class Planner(ManagedNode):
    """
    Plans for the problem that the parameter `problem` names.

    Service `plan` (std_srvs/Trigger) answers with one line of JSON. Solving runs beside the
    executor: states, parameters and further requests (BUSY) are served meanwhile. What is
    published, and where the state comes from, is the adapter's matter.
    """

    decisive = frozenset({'problem'})

    def __init__(self, **options: Any) -> None:
        super().__init__('planner', 'planning', _REQUEST, **options)
        self._problem_class: type[Problem] | None = None
        self._adapter: Adapter | None = None
        self._replanning: Replanning | None = None
        self._fault = ''
        self._load_problem()
        self.warn_of_unknown_overrides()
        self._plan: Plan | None = None
        self._plan_id = 0
        self._failure: Failure | None = None
        self._superseded = False
        self._expect(None)
        self._requests = self._failures = 0
        self._worker = Worker(self)
        self._prepared = threading.Event()
        self._preparing = False
        self._activation = 0
        self._unanswered: list[_Reply] = []
        self._watch_clock()
        self.bring_up()

    def configure(self) -> None:
        """Connect the problem, and begin to prepare it."""
        if self._problem_class is not None:
            self._adapter = adapter_class(self._problem_class)(self, self.parameter_values)
        self._summary = self.create_publisher(String, SUMMARY, LATCHED)
        self._replanning = Replanning(self, self._worker, self._take_over)
        self._replanning.set_up(self._adapter, self.parameter_values)
        if not self._preparing:  # once: what is compiled stays
            self._preparing = True
            tell_of_compilation(self.get_logger().info)
            Worker(self).submit(self._prepare, self._on_prepared)
        DeferredService(self, Trigger, 'plan', self._on_request)
        self._others = OtherPlanners(self, self._on_other_plan, self._diagnostics.update)
        if self._adapter is not None:
            self._adapter.accept_requests(self._plan_with)
            Recovery(self, self._adapter, self._recover)

    def activate(self) -> None:
        """Serve requests from now on, and go on to review the plan in force."""
        assert self._replanning is not None
        if self._adapter is not None:
            self._adapter.values_changed(self.parameter_values)
        self._replanning.active = True

    def deactivate(self) -> None:
        """Refuse the requests that are not answered yet; what is being solved comes to nothing."""
        assert self._replanning is not None
        self._replanning.active = False
        self._activation += 1
        failure = Failure.of(Inactive('the planner was deactivated before there was a plan'))
        for reply in list(self._unanswered):
            self._answer(reply, failure)

    def cleanup(self) -> None:
        """Forget the plan in force: its topics are gone."""
        self._adapter = self._replanning = self._plan = self._failure = None
        self._superseded = False
        self._expect(None)

    def check_values(self, values: Mapping[str, Any]) -> None:
        """Refuse values for which the problem cannot say which parameters it has."""
        if self._problem_class is not None:
            self._problem_class.parameter_specifications(values)

    def values_changed(self, names: frozenset[str]) -> None:
        """Let changed parameters act from the next request on."""
        self._declare_problem()
        if self._adapter is not None:
            self._adapter.values_changed(self.parameter_values)
        if self._replanning is not None:
            self._replanning.set_up(self._adapter, self.parameter_values)
        super().values_changed(names)
        self._diagnostics.update()

    def _load_problem(self) -> None:
        self._problem_class = load_problem(self.parameter_values['problem'])
        try:
            self._declare_problem()
        except InvalidProblem as error:
            self._problem_class = None
            self._fault = str(error)
            self.get_logger().error(self._fault)

    def _declare_problem(self) -> None:
        """Declare the problem's parameters; which exist may depend on values (robots' names)."""
        if self._problem_class is None:
            return
        declared: set[str] = set()
        while True:
            wanted = self._problem_class.parameter_specifications(self.parameter_values)
            self.declare(wanted)
            if set(wanted) == declared:
                break
            declared = set(wanted)
        kept = declared | set(_REQUEST)
        self.withdraw([name for name in self.parameter_values if name not in kept])

    def _watch_clock(self) -> None:
        """Notice when the time of day is set, or simulated time begins anew."""
        self._time = MotionClock(self, self._on_clock_step)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._clock_timer = self.create_timer(_CLOCK_PERIOD, self._on_clock_timer, clock=steady)
        self._jumps = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
            ),
            post_callback=self._on_simulated_jump,
        )

    def _on_clock_timer(self) -> None:
        self._time.now()
        self._look_who_follows()

    def _expect(self, start: int | None) -> None:
        """Have a look, after the start [ns] of a plan, who does not follow it; None: no look."""
        self._expected, self._unfollowed = start, ''

    def _look_who_follows(self) -> None:
        """Name the trackers that do not follow the active plan once it has begun."""
        start, adapter = self._expected, self._adapter
        if start is None or adapter is None or (self._now() - start) * NANOSECOND < _GRACE:
            return
        self._expected, names = None, adapter.not_following(start)
        if names:
            self._unfollowed = (
                f'plan {self._plan_id} is not followed by {", ".join(names)}: the tracker says why'
            )
            self.get_logger().warning(self._unfollowed)
            self._diagnostics.update()

    def _on_clock_step(self, step: float) -> None:
        """Let the plan in force go on as the plant does, which the clock is not told of."""
        self.get_logger().warning(f'the clock was set by {step:+.3g} s: the plan in force goes on')
        nanoseconds = round(step / NANOSECOND)
        if self._replanning is not None:
            self._replanning.clock_was_set(nanoseconds)
        if self._adapter is not None:
            self._adapter.clock_was_set(nanoseconds)
        if self._plan is not None:
            self._moved(replace(self._plan, start=self._plan.start + nanoseconds))

    def _on_simulated_jump(self, jump: TimeJump) -> None:
        """Forget the plan in force when simulated time is set back: trackers give it up."""
        if not ros_clock(self).ros_time_is_active or self._plan is None:
            return
        self.get_logger().warning('simulated time was set back: the plan in force is given up')
        if self._adapter is not None:
            self._adapter.clock_was_set(None)
        self._moved(None)

    def _moved(self, plan: Plan | None) -> None:
        self._plan = plan
        self._expect(None)
        if self._replanning is not None and not self._superseded:
            self._replanning.plan = plan

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _prepare(self) -> str:
        """Do what does not depend on a request; in the worker's thread."""
        try:
            if self._problem_class is not None:
                self._problem_class.from_parameters({}).prepare()
        except Exception as error:  # noqa: B902
            # Planning will meet it again, and say so in its answer.
            return f'{type(error).__name__}: {" ".join(str(error).split())}'
        finally:
            self._prepared.set()
        return ''

    def _on_prepared(self, fault: str) -> None:
        if fault:
            self.get_logger().error(f'preparing the problem failed: {fault}')
        elif self._problem_class is not None:
            gc.freeze()  # what has been loaded meanwhile, see `run`
            self.get_logger().info(f'ready to plan for {self._problem_class.name}')
        self._diagnostics.update()

    def _on_request(self, _: Trigger.Request, response: Trigger.Response, answer: Answer) -> None:
        def reply(outcome: Plan | Failure) -> None:
            response.success = isinstance(outcome, Plan)
            response.message = (
                plan_answer(outcome, self._plan_id, self._warnings())
                if isinstance(outcome, Plan)
                else outcome.to_json()
            )
            answer(response)

        self._requests += 1
        refusal = self._refusal()
        if refusal is not None:
            reply(Failure.of(refusal))
            return
        self._when_free(reply, lambda: self._solve(self.parameter_values, reply))

    def _plan_with(
        self, changes: Mapping[str, Any], purpose: str, done: Callable[[str], None]
    ) -> None:
        """Plan with changed parameters; see `tdm_planner.nodes.adapters.base.PlanRequest`."""

        def reply(outcome: Plan | Failure) -> None:
            done(f'{outcome.code}: {outcome.reason}' if isinstance(outcome, Failure) else '')

        self._requests += 1
        refusal = self._refusal()
        if refusal is not None:
            failure = Failure.of(refusal)
            self._log_failure(failure, f'{purpose} refused')
            reply(failure)
            return
        values = {**self.parameter_values, **changes}
        self._when_free(reply, lambda: self._solve(values, reply, changes, f'{purpose} refused'))

    def _refusal(self) -> Busy | Inactive | None:
        """
        Return why no request is taken: the node is not active, or a request is being solved.

        For a review of the plan in force a request waits.
        """
        if not self.active:
            return Inactive(
                f"the planner is inactive: 'ros2 lifecycle set {self.get_fully_qualified_name()} "
                "activate' lets it plan"
            )
        yields = self._replanning is not None and self._replanning.yields
        return Busy(_BUSY) if self._worker.busy and not yields else None

    def _when_free(self, reply: _Reply, solve: Callable[[], None]) -> None:
        """Solve now, or when the review under way has ended, unless the node is deactivated."""
        assert self._replanning is not None
        activation = self._activation
        self._unanswered.append(reply)
        self._replanning.when_free(lambda: solve() if activation == self._activation else None)

    def _answer(self, reply: _Reply, outcome: Plan | Failure) -> None:
        """Answer a request, once."""
        if reply in self._unanswered:
            self._unanswered.remove(reply)
            reply(outcome)

    def _warnings(self) -> list[str]:
        """Name, and log, what will not carry the plan out."""
        found = [] if self._adapter is None else self._adapter.warnings()
        for sentence in found:
            self.get_logger().warning(sentence)
        return found

    def _on_other_plan(self, start: int) -> None:
        """Cease to review the own plan when another planner's starts after it."""
        if self._superseded or (self._plan is not None and start < self._plan.start):
            return
        self._superseded = True
        self._expect(None)
        if self._replanning is not None:
            self._replanning.plan = None
        if self._plan is not None:
            self.get_logger().warning(f'{_SUPERSEDED}: plan {self._plan_id} is not reviewed now')
        self._diagnostics.update()

    def _recover(self, trajectories: Mapping[str, Trajectory], start: int) -> None:
        """Publish again what trackers follow and no planner publishes any more."""
        problem_class, adapter, values = self._problem_class, self._adapter, self.parameter_values
        if problem_class is None or adapter is None or self._others.published(start):
            return
        activation = self._activation

        def job() -> Plan | Failure:
            self._prepared.wait()
            try:
                return Plan(*adapter.recognised(problem_class, values, trajectories), start)
            except Exception as error:  # noqa: B902
                return Failure.of(error)

        def done(outcome: Plan | Failure) -> None:
            if activation != self._activation or self._plan is not None:
                return
            if isinstance(outcome, Failure):
                self._log_failure(outcome, 'the plan that is followed is not taken over')
            else:
                self._publish(outcome)
                self.get_logger().info(f'plan {self._plan_id} was followed already: taken over')
            self._diagnostics.update()

        Worker(self).submit(job, done)

    def _take_over(self, plan: Plan) -> None:
        """Publish a plan made on the way."""
        self._settle(plan)

    def _solve(
        self,
        values: dict[str, Any],
        reply: _Reply = _nobody,
        changes: Mapping[str, Any] = _NO_CHANGES,
        title: str = 'no plan',
    ) -> None:
        problem_class, adapter = self._problem_class, self._adapter
        faults = self.faults()
        if faults or problem_class is None or adapter is None:
            failure = Failure.of(InvalidProblem('; '.join(faults)))
            self._answer(reply, self._settle(failure, title=title))
            return
        activation = self._activation

        def job() -> Plan | Failure:
            self._prepared.wait()
            return make_plan(problem_class, values, adapter, self._now)

        def done(outcome: Plan | Failure) -> None:
            if activation == self._activation:
                self._answer(reply, self._settle(outcome, changes, title))

        self._worker.submit(job, done)
        self._diagnostics.update()

    def _settle(
        self,
        outcome: Plan | Failure,
        changes: Mapping[str, Any] = _NO_CHANGES,
        title: str = 'no plan',
    ) -> Plan | Failure:
        """
        Publish a plan, or keep the one in force and say why there is no new one.

        The parameters that the plan was made with, as far as they were changed, are set first.
        """
        if isinstance(outcome, Plan):
            try:
                self._adopt(changes)
                self._publish(outcome)
                self._warn_of_lateness(outcome)
            except Exception as error:  # noqa: B902
                outcome = Failure.of(error)
        if isinstance(outcome, Failure):
            self._failure = outcome
            self._failures += 1
            self._log_failure(outcome, title)
        self._diagnostics.update()
        return outcome

    def _adopt(self, changes: Mapping[str, Any]) -> None:
        if changes:
            parameters = [self._as_ros(name, value) for name, value in changes.items()]
            result = self.set_parameters_atomically(parameters)
            if not result.successful:
                raise InvalidProblem(result.reason)

    def _log_failure(self, failure: Failure, title: str) -> None:
        # Two calls: rclpy does not let a place in the code change its severity.
        if failure.trace:
            text = f'{title}: {failure.code}: {failure.reason}\n{failure.trace}'
            self.get_logger().error(text)
        else:
            self.get_logger().warning(f'{title}: {failure.code}: {failure.reason}')

    def _publish(self, plan: Plan) -> None:
        assert self._adapter is not None
        assert self._replanning is not None
        self._adapter.publish(plan.problem, plan.solution, plan.start)
        self._plan, self._failure, self._superseded = plan, None, False
        self._replanning.plan = plan
        self._plan_id += 1
        self._others.publishes(plan.start)
        self._expect(plan.start)
        self._summary.publish(String(data=plan_summary(plan, self._plan_id)))
        self.get_logger().info(f'plan {self._plan_id}: {plan.solution.summary}')

    def _warn_of_lateness(self, plan: Plan) -> None:
        late = (self._now() - plan.start) * NANOSECOND
        if late > 0:
            self.get_logger().warning(
                f'plan {self._plan_id} is published {late:.3f} s after the start of its motion: '
                "raise 'start.delay' or lower 'solver.deadline'"
            )

    def report(self) -> Report:
        """Return state, figures of the plan in force, ages of the measured states."""
        now = self._now()
        level, message = self._state()
        values: dict[str, Any] = {
            'problem': self.parameter_values['problem'],
            'requests': self._requests,
            'failures': self._failures,
            'plan id': self._plan_id,
        }
        if self._plan is not None:
            values.update(plan_figures(self._plan, now))
        if self._replanning is not None:
            values.update(self._replanning.figures())
        if self._adapter is not None:
            for name, age in self._adapter.ages(now).items():
                values[f'age of {name} [s]'] = 'never received' if age is None else age
        return Report(level, message, values)

    def faults(self) -> list[str]:
        """Return what makes every request vain until it is corrected."""
        return [*filter(None, [self._fault]), *super().faults()]

    def _state(self) -> tuple[Level, str]:
        faults = self.faults()
        if faults:
            return Level.ERROR, '; '.join(faults)
        if self._worker.busy:
            return Level.OK, 'planning'
        if self._failure is not None:
            level = Level.ERROR if self._failure.trace else Level.WARN
            return level, f'{self._failure.code}: {self._failure.reason}'
        told = [_SUPERSEDED * self._superseded, self._others.warning, self._unfollowed]
        if any(told):
            return Level.WARN, '; '.join(filter(None, told))
        if not self._prepared.is_set():
            return Level.OK, 'preparing'
        if self._plan is None:
            return Level.OK, 'ready'
        return Level.OK, f'plan {self._plan_id} in force'


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is asked to end."""
    return run(Planner, args)


if __name__ == '__main__':
    sys.exit(main())

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One request, from parameters and measured state to a verified plan or the reason for none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import json
import time
import traceback
from typing import Any

from tdm_planner.exceptions import (
    DeadlineExceeded,
    ERRORS,
    Infeasible,
    InvalidProblem,
    NoState,
    TdmError,
    VerificationFailed,
)
from tdm_planner.nodes.adapters import Adapter
from tdm_planner.nodes.motion_clock import NO_TIME
from tdm_planner.plan_files import figures_of, finite
from tdm_planner.plant_kind import plan_kind, QUANTITIES
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.trajectory import NANOSECOND, Trajectory

CODES = tuple(error.code for error in ERRORS)

_RETRIES = (0.5, 0.25)  # shares of `start.delay` after which a motion may begin instead
_SHORTEST = 0.01  # s; in less nothing is found
_PREPARING = 0.5  # share of `start.delay` that is left when a plan is ready
_MARGIN = 0.1  # s that checking and publishing a plan may take
_LOOK = 0.002  # s between looks at the clock, and for a first state
_PATIENCE = 10.0  # s, the longest wait for a first state: BUSY is answered meanwhile


@dataclass(frozen=True, eq=False)
class Plan:
    """
    A verified solution; its motion starts at the instant `start` [ns] of the node's clock.

    `own` are the parameters that were given for this plan alone, by name (`plan_with`); `whole` is
    the cost of the whole way where it was made on the way, see `ActivePlan`.
    """

    problem: Problem
    solution: Solution
    start: int
    own: Mapping[str, Any] = field(default_factory=dict)
    whole: float | None = None


@dataclass(frozen=True)
class Failure:
    """Why there is no plan; `trace` is the traceback of a fault of the program, else empty."""

    code: str
    reason: str
    trace: str = ''

    @classmethod
    def of(cls, error: Exception) -> Failure:
        """Return the failure that an exception stands for: what is no TdmError is INTERNAL."""
        text = ' '.join(str(error).split())
        if isinstance(error, TdmError):
            return cls(error.code, text)
        trace = ''.join(traceback.format_exception(error))
        return cls('INTERNAL', f'{type(error).__name__}: {text}', trace)

    def __str__(self) -> str:
        """Return code and reason, and the traceback where there is one."""
        return '\n'.join(filter(None, [f'{self.code}: {self.reason}', self.trace]))

    def to_json(self) -> str:
        """Return the answer to the request, one line."""
        return json.dumps({'code': self.code, 'reason': self.reason})


def make_plan(
    problem_class: type[Problem],
    values: Mapping[str, Any],
    adapter: Adapter,
    clock: Callable[[], int],
) -> Plan:
    """
    Plan for the parameters `values` (the problem's and the request's).

    `clock` returns the present instant [ns].

    Raises
    ------
    TdmError
        Saying why there is no plan.

    """
    measured = values['start.source'] == 'measured' and adapter.measures
    if measured:
        _await_first_state(adapter, values['start.max_age'], clock)
    now = clock()
    if now <= 0:
        raise NoState(NO_TIME)
    if measured:
        return _plan_from_measured(problem_class, values, adapter, clock)
    problem = problem_class.from_parameters(values)
    solution = _verified(problem.solve())
    delay = values['start.delay']
    return Plan(problem, solution, _in_time(now + round(delay / NANOSECOND), delay, clock))


def _plan_from_measured(
    problem_class: type[Problem],
    values: Mapping[str, Any],
    adapter: Adapter,
    clock: Callable[[], int],
) -> Plan:
    """
    Plan from the measured state; sooner than `start.delay` where that is too late.

    A plant in motion may have left its limits, or be beyond help, by the time a motion starts.
    """
    failure: TdmError | None = None
    now = _after_a_start(adapter, values, clock)
    delays = [share * values['start.delay'] for share in (1.0, *_RETRIES)]
    starts = [now + round(delay / NANOSECOND) for delay in delays]
    for delay, start, sooner in zip(delays, starts, [*starts[1:], None], strict=True):
        measured = adapter.measured_start(values, now, start)
        try:
            problem = problem_class.from_parameters({**values, **measured})
            allowed = problem.solver.deadline
            if failure is not None:
                allowed = min(allowed, _time_until(start, sooner, clock()))
                if allowed < _SHORTEST:
                    break
            solution = _verified(problem.solve(deadline=allowed))
            if adapter.rests(now):
                start = _in_time(start, delay, clock)
            return Plan(problem, solution, start)
        except (InvalidProblem, Infeasible) as error:
            if failure is None and isinstance(error, (DeadlineExceeded, VerificationFailed)):
                raise
            failure = failure or _of_the_future(error, delay)
    assert failure is not None
    raise failure


def _in_time(start: int, delay: float, clock: Callable[[], int]) -> int:
    """Put a start [ns] off that solving has left too little of the `delay` [s] for."""
    return max(start, clock() + round(_PREPARING * delay / NANOSECOND))


def _await_first_state(adapter: Adapter, max_age: float, clock: Callable[[], int]) -> None:
    """
    Wait for simulated time and for states that were never received, at most `max_age` s.

    Raises
    ------
    NoState
        Naming what is missing, and how long it was waited for.

    """
    longest = min(max_age, _PATIENCE)
    end = time.monotonic() + longest
    while (clock() <= 0 or adapter.missing()) and time.monotonic() < end:
        time.sleep(_LOOK)
    missing = adapter.missing()
    if missing and clock() > 0:
        raise NoState(f'{"; ".join(missing)} within {longest:g} s (start.max_age)')


def _time_until(start: int, sooner: int | None, now: int) -> float:
    """Time [s] to plan what begins at `start`; half is left for what may begin `sooner`."""
    if sooner is not None:
        half = 0.5 * (sooner - now) * NANOSECOND
        if half >= _SHORTEST:
            return half
    return (start - now) * NANOSECOND


def _after_a_start(adapter: Adapter, values: Mapping[str, Any], clock: Callable[[], int]) -> int:
    """
    Return the instant to plan at [ns]: the present, or that of the newest plan's start.

    It is waited for where a plan made now could be published after it. From then on the plant
    follows that plan; until then, the one before.
    """
    now = clock()
    begins = adapter.next_start(now)
    longest = max(values['solver.deadline'], max(_RETRIES) * values['start.delay']) + _MARGIN
    if begins is None or (begins - now) * NANOSECOND > longest:
        return now
    patience = time.monotonic() + 2.0 * longest  # simulated time may stand still
    while (now := clock()) < begins and time.monotonic() < patience:
        time.sleep(_LOOK)
    return now


def _verified(solution: Solution) -> Solution:
    """Return a solution that its own check approves of, whoever has written the problem."""
    check = solution.verification
    if not check.ok:
        why = '; '.join(check.reasons) or 'it gives no reasons'
        raise VerificationFailed(f'the plan does not pass its own check: {why}')
    return solution


def _of_the_future(error: TdmError, delay: float) -> TdmError:
    """Return the error with a note that its start is predicted, where it speaks of one."""
    text = str(error)
    if 'start' in text:
        text += f' (as predicted from the measured state for {delay:g} s later, start.delay)'
    return type(error)(text)


def plan_answer(plan: Plan, plan_id: int, warnings: Sequence[str] = ()) -> str:
    """
    Return the answer of the `plan` service to a request that was met, one line of JSON.

    `warnings`, where there are any, are added: sentences about what is not connected.
    """
    solution = plan.solution
    added = {'warnings': list(warnings)} if warnings else {}
    document = {
        'plan_id': plan_id,
        'duration': solution.duration,
        'cost': solution.cost,
        'penalty': solution.penalty,
        'solve_time': solution.solve_time,
        'evaluations': solution.evaluations,
        'summary': ' '.join(solution.summary.split()),
        **added,
    }
    return json.dumps(finite(document), allow_nan=False)


def plan_summary(plan: Plan, plan_id: int) -> str:
    """
    Return everything about a plan but its samples, one line of JSON, for recordings.

    The figures of the service's answer; `stamp`, the start of the motion; the parts of the cost;
    the check, with the instants of the worst margins; per vehicle, what trajectory messages do not
    say (which states and controls their joints have among it); the problem's parameters by dotted
    name. A number that is not finite is null.
    """
    solution = plan.solution
    second = round(1.0 / NANOSECOND)
    document = {
        'plan_id': plan_id,
        'stamp': {'sec': plan.start // second, 'nanosec': plan.start % second},
        **figures_of(solution),
        'summary': ' '.join(solution.summary.split()),
        'verification': solution.verification.to_dict(),
        'vehicles': {
            name: {
                'duration': trajectory.duration,
                'interpolation': trajectory.interpolation,
                'units': trajectory.units,
                'states': trajectory.state_names,
                'controls': trajectory.control_names,
                'joints': _joints(plan.problem, trajectory),
            }
            for name, trajectory in solution.trajectories.items()
        },
        'parameters': plan.problem.to_parameters(),
    }
    return json.dumps(finite(document), allow_nan=False)


def _joints(problem: Problem, trajectory: Trajectory) -> dict[str, dict[str, str]]:
    """Return the states and controls that are position, velocity and effort of every joint."""
    return {
        joint.name: {what: getattr(joint, what) for what in QUANTITIES if getattr(joint, what)}
        for joint in plan_kind(problem, trajectory).joints
    }


def plan_figures(plan: Plan, now: int) -> dict[str, Any]:
    """Return what the diagnostics show of the active plan."""
    solution = plan.solution
    check = solution.verification
    figures: dict[str, Any] = {
        'plan age [s]': (now - plan.start) * NANOSECOND,
        'duration [s]': solution.duration,
        'cost': float(solution.cost),
        'penalty': float(solution.penalty),
        'solve time [s]': solution.solve_time,
        'evaluations': solution.evaluations,
    }
    if check.worst:
        narrowest = min(check.worst, key=lambda name: check.worst[name])
        figures['worst margin'] = f'{check.worst[narrowest]:.6g} ({narrowest})'
    figures.update({f'margin of {name}': float(value) for name, value in check.worst.items()})
    return figures

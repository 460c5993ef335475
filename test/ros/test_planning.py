# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""From parameters and a measured state to a plan or the reason for none, without ROS running."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tdm_planner.exceptions import Busy, DeadlineExceeded, Inactive, Infeasible, TdmError
from tdm_planner.nodes.planning import Failure, make_plan, Plan, plan_answer
from tdm_planner.tracking.tracker import TrajectoryRefused

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND


class Clock:
    """A clock that runs; `passed` [s] since it was made."""

    def __init__(self) -> None:
        self._begin = time.monotonic_ns()

    def __call__(self) -> int:
        return BEGIN + time.monotonic_ns() - self._begin

    @property
    def passed(self) -> float:
        return (self() - BEGIN) / SECOND


class Adapter:
    """Measures how far ahead it is asked to look; a plan begins at `begins` [s]."""

    measures = True

    def __init__(self, begins: float = -1.0, comes: float = 0.0) -> None:
        self.comes = time.monotonic() + comes
        self.begins = BEGIN + round(begins * SECOND)
        self.asked: list[float] = []

    def next_start(self, now: int) -> int | None:
        return self.begins if self.begins > now else None

    def missing(self) -> list[str]:
        return ['no state was received on /there'] if time.monotonic() < self.comes else []

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        self.asked.append((now - BEGIN) / SECOND)
        return {'start.x': (start - now) / SECOND}


def solution(ok: bool = True, **changes: Any) -> Any:
    check = SimpleNamespace(ok=ok, reasons=() if ok else ('it hits the wall',))
    figures = {'duration': 1.0, 'cost': 1.0, 'penalty': 0.0, 'solve_time': 0.1}
    return SimpleNamespace(
        verification=check, **{**figures, 'evaluations': 3, 'summary': 'a plan', **changes}
    )


class Problem:
    """Solved at once; `deadline` s are allowed."""

    deadline = 0.3

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.solver = SimpleNamespace(deadline=self.deadline)

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> Problem:
        return cls(values)

    def solve(self, deadline: float | None = None) -> Any:
        return solution()


class Unchecked(Problem):
    """One's own, that answers with what its check objects to."""

    def solve(self, deadline: float | None = None) -> Any:
        return solution(ok=False)


class Distant(Problem):
    """Finds after a while that nothing can be done from a start so far ahead."""

    def solve(self, deadline: float | None = None) -> Any:
        time.sleep(min(0.25, 0.8 * (deadline or 1.0)))
        if self.values['start.x'] > 0.3:
            raise Infeasible('there is no way from this start')
        return solution()


def request(kind: Any, adapter: Any, source: str = 'measured', delay: float = 0.4) -> Any:
    clock = Clock()
    values = {
        'start.source': source,
        'start.delay': delay,
        'start.max_age': 0.5,
        'solver.deadline': kind.deadline,
    }
    return make_plan(kind, values, adapter, clock), clock


@pytest.mark.parametrize('source', ['measured', 'parameters'])
def test_what_its_own_check_objects_to_is_no_plan(source: str) -> None:
    made, _ = request(Unchecked, Adapter(), source)
    assert isinstance(made, Failure)
    assert made.code == 'VERIFICATION_FAILED'
    assert 'it hits the wall' in made.reason


def test_the_first_state_is_waited_for() -> None:
    adapter = Adapter(comes=0.2)
    made, _ = request(Problem, adapter)
    assert isinstance(made, Plan)
    assert adapter.asked[0] >= 0.19
    assert made.start >= BEGIN + round((adapter.asked[0] + 0.4) * SECOND)


def test_a_state_that_does_not_come_is_named_with_the_time_waited() -> None:
    made, clock = request(Problem, Adapter(comes=1e6))
    assert isinstance(made, Failure)
    assert made.code == 'NO_STATE'
    assert made.reason == 'no state was received on /there within 0.5 s (start.max_age)'
    assert clock.passed >= 0.5
    assert isinstance(request(Problem, Adapter(comes=1e6), source='parameters')[0], Plan)


class Faulty(Problem):
    """Its solver has a fault, or an error with a code of its own."""

    error: Exception = KeyError('no such column')

    def solve(self, deadline: float | None = None) -> Any:
        raise self.error


def test_a_fault_of_the_program_is_internal_and_has_its_traceback() -> None:
    made, _ = request(Faulty, Adapter())
    assert isinstance(made, Failure)
    assert (made.code, made.reason) == ('INTERNAL', "KeyError: 'no such column'")
    assert 'raise self.error' in made.trace
    assert json.loads(made.to_json()) == {'code': made.code, 'reason': made.reason}


def test_an_error_of_the_package_keeps_its_code_and_has_no_traceback() -> None:
    for error in (Inactive('not active'), Busy('solving'), TrajectoryRefused('too far')):
        made = Failure.of(error)
        assert (made.code, made.reason, made.trace) == (error.code, str(error), '')
    assert Inactive.code == 'INACTIVE'


def test_a_plan_that_may_begin_meanwhile_is_waited_for() -> None:
    adapter = Adapter(begins=0.2)
    made, _ = request(Problem, adapter)
    assert isinstance(made, Plan)
    assert adapter.asked[0] >= 0.2
    assert made.start == BEGIN + round((adapter.asked[0] + 0.4) * SECOND)


def test_a_plan_that_is_replaced_before_it_begins_is_not() -> None:
    adapter = Adapter(begins=5.0)
    request(Problem, adapter)
    assert adapter.asked[0] < 0.2


def test_a_clock_that_stands_still_is_not_waited_for_without_end() -> None:
    values = {
        'start.source': 'measured',
        'start.delay': 0.1,
        'start.max_age': 0.5,
        'solver.deadline': 0.1,
    }
    adapter = Adapter(begins=0.1)
    began = time.monotonic()
    made = make_plan(Problem, values, adapter, lambda: BEGIN)  # type: ignore[arg-type]
    assert isinstance(made, Plan)
    assert time.monotonic() - began < 5.0


def test_what_begins_sooner_is_not_begun_too_late() -> None:
    """Half the delay has passed when the first attempt fails: no time is left for the others."""
    made, _ = request(Distant, Adapter())
    assert isinstance(made, Failure)
    assert made.code == 'INFEASIBLE'
    made, clock = request(Distant, Adapter(), delay=0.56)
    assert isinstance(made, Plan)
    assert clock() <= made.start


class Late(Problem):
    """Far ahead there is no way; nearer, none is found with `error` in all the time there is."""

    error: type[TdmError] = Infeasible

    def solve(self, deadline: float | None = None) -> Any:
        ahead = self.values['start.x']
        if ahead > 0.7:
            raise Infeasible('there is no way from this start')
        if ahead > 0.3:
            time.sleep(deadline or self.deadline)
            raise self.error('nothing was found')
        return solution()


@pytest.mark.parametrize('error', [Infeasible, DeadlineExceeded])
def test_an_attempt_leaves_time_for_what_begins_sooner(error: type[TdmError]) -> None:
    made, clock = request(type('Late', (Late,), {'error': error}), Adapter(), delay=0.8)
    assert isinstance(made, Plan)
    assert made.start - BEGIN < 0.25 * SECOND
    assert clock() <= made.start


class Lost(Late):
    """There is no way, and none is found nearer."""

    def solve(self, deadline: float | None = None) -> Any:
        super().solve(deadline)
        raise DeadlineExceeded('nothing was found')


def test_the_first_attempt_says_why_there_is_no_plan() -> None:
    """Not the last, that had the least time."""
    made, _ = request(Lost, Adapter(), delay=0.8)
    assert isinstance(made, Failure)
    assert made.code == 'INFEASIBLE'
    assert 'there is no way from this start' in made.reason


@pytest.mark.parametrize(('cost', 'told'), [(np.float32(1.5), 1.5), (math.nan, None)])
def test_the_answer_is_json_whatever_a_problem_of_ones_own_returns(cost: Any, told: Any) -> None:
    plan = Plan(Problem({}), solution(cost=cost), BEGIN)  # type: ignore[arg-type]
    answer = json.loads(plan_answer(plan, 1), parse_constant=pytest.fail)
    assert answer['cost'] == told

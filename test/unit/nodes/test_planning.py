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
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tdm_planner.exceptions import (
    Busy,
    DeadlineExceeded,
    Failure,
    Inactive,
    Infeasible,
    InvalidProblem,
    NoState,
)
from tdm_planner.nodes import planning
from tdm_planner.nodes.planning import make_plan
from tdm_planner.nodes.services import plan_answer
from tdm_planner.replanning import ActivePlan
from tdm_planner.tracking import TrajectoryRejected

BEGIN = 1_700.0  # s


class Clock:
    """The node's clock, and the machine's: runs while somebody sleeps; `passed` s so far."""

    passed = 0.0
    runs = True

    def now(self) -> float:
        return BEGIN + self.passed

    def monotonic(self) -> float:
        return self.passed

    def sleep(self, seconds: float) -> None:
        self.passed += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    Problem.clock = made = Clock()
    monkeypatch.setattr(planning, 'time', made)
    return made


class Adapter:
    """Measures how far ahead it is asked to look; a plan begins at `begins`, a state comes [s]."""

    measures = True

    def __init__(self, begins: float = -1.0, comes: float = 0.0, rests: bool = False) -> None:
        self._rests = rests
        self.comes, self.begins = comes, BEGIN + begins
        self.asked: list[float] = []

    @property
    def plans(self) -> Adapter:
        return self

    def next_start(self, now: float) -> float | None:
        return self.begins if self.begins > now else None

    def rests(self, now: float) -> bool:
        return self._rests

    def missing(self) -> list[str]:
        there = Problem.clock.passed >= self.comes
        return [] if there else ['no state was received on /there']

    def measured_start(
        self, values: Mapping[str, Any], now: float, start: float
    ) -> dict[str, Any]:
        self.asked.append(now - BEGIN)
        return {'start.x': start - now}


def solution(ok: bool = True, **changes: Any) -> Any:
    check = SimpleNamespace(ok=ok, reasons=() if ok else ('it hits the wall',))
    figures = {'duration': 1.0, 'cost': 1.0, 'penalty': 0.0, 'solve_time': 0.1}
    return SimpleNamespace(
        verification=check, **{**figures, 'evaluations': 3, 'summary': 'a plan', **changes}
    )


class Problem:
    """Solved at once; .3 s are allowed."""

    deadline = 0.3
    clock: Clock

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


class Faulty(Problem):
    """Its solver has a fault, or an error with a code of its own."""

    error: Exception = KeyError('no such column')

    def solve(self, deadline: float | None = None) -> Any:
        raise self.error


class Distant(Problem):
    """Finds after a while that nothing can be done from a start so far ahead."""

    def solve(self, deadline: float | None = None) -> Any:
        self.clock.sleep(min(0.25, 0.8 * (deadline or 1.0)))
        if self.values['start.x'] > 0.3:
            raise Infeasible('there is no way from this start')
        return solution()


class Late(Problem):
    """Far ahead there is no way; nearer, none is found with `error` in all the time there is."""

    error: type[Exception] = Infeasible

    def solve(self, deadline: float | None = None) -> Any:
        ahead = self.values['start.x']
        if ahead > 0.7:
            raise Infeasible('there is no way from this start')
        if ahead > 0.3:
            self.clock.sleep(deadline or self.deadline)
            raise self.error('nothing was found')
        return solution()


class Lost(Late):
    """There is no way, and none is found nearer."""

    def solve(self, deadline: float | None = None) -> Any:
        super().solve(deadline)
        raise DeadlineExceeded('nothing was found')


class Slow(Problem):
    """Takes longer than the start is ahead."""

    def solve(self, deadline: float | None = None) -> Any:
        self.clock.sleep(2.0)
        return solution()


def values(kind: Any, source: str = 'measured', delay: float = 0.4) -> dict[str, Any]:
    request = {'start.source': source, 'start.delay': delay, 'start.max_age': 0.5}
    return {**request, 'solver.deadline': kind.deadline}


def plan(kind: Any, adapter: Any = None, **request: Any) -> ActivePlan:
    clock: Any = Problem.clock
    given: Any = adapter or Adapter()
    made = make_plan(kind, values(kind, **request), given, clock)
    assert clock.now() <= made.start
    return made


def failure(kind: Any, adapter: Any = None, **request: Any) -> Failure:
    with pytest.raises(Exception) as raised:  # noqa: PT011
        plan(kind, adapter, **request)
    return Failure.of(raised.value)


@pytest.mark.parametrize('source', ['measured', 'parameters'])
def test_what_its_own_check_objects_to_is_no_plan(source: str) -> None:
    made = failure(Unchecked, source=source)
    assert made.code == 'VERIFICATION_FAILED'
    assert 'it hits the wall' in made.reason


def test_the_first_state_is_waited_for() -> None:
    adapter = Adapter(comes=0.2)
    made = plan(Problem, adapter)
    assert adapter.asked == [pytest.approx(0.2)]
    assert made.start == pytest.approx(BEGIN + 0.6)


@pytest.mark.parametrize(('max_age', 'waited'), [(0.5, 0.5), (60.0, 10.0)])
def test_a_state_that_does_not_come_is_named_with_the_time_waited(
    clock: Clock, max_age: float, waited: float
) -> None:
    asked: Any = {**values(Problem), 'start.max_age': max_age}
    reason = rf'no state was received on /there within {waited:g} s \(start.max_age\)'
    with pytest.raises(NoState, match=reason):
        make_plan(Problem, asked, Adapter(comes=1e6), clock)  # type: ignore[arg-type]
    assert clock.passed == pytest.approx(waited, abs=0.01)
    plan(Problem, Adapter(comes=1e6), source='parameters')


def test_without_time_there_is_no_plan(clock: Clock) -> None:
    asked, clock.runs = values(Problem, source='parameters'), False
    with pytest.raises(NoState, match='/clock'):
        make_plan(Problem, asked, Adapter(), clock)  # type: ignore[arg-type]


def test_a_fault_of_the_program_is_internal_and_has_its_traceback() -> None:
    made = failure(Faulty)
    assert (made.code, made.reason) == ('INTERNAL', "KeyError: 'no such column'")
    assert 'raise self.error' in made.trace
    assert json.loads(made.to_json()) == {'code': made.code, 'reason': made.reason}


def test_an_error_of_the_package_keeps_its_code_and_has_no_traceback() -> None:
    for error in (Inactive('not active'), Busy('solving'), TrajectoryRejected('too far')):
        made = Failure.of(error)
        assert (made.code, made.reason, made.trace) == (error.code, str(error), '')
    assert Inactive.code == 'INACTIVE'


@pytest.mark.parametrize(('begins', 'asked'), [(0.2, 0.2), (0.399, 0.4), (0.41, 0.0)])
def test_a_plan_that_may_begin_meanwhile_is_waited_for(begins: float, asked: float) -> None:
    """One that begins later is replaced before: the deadline of .3 s and .1 s to publish it."""
    adapter = Adapter(begins)
    made = plan(Problem, adapter)
    assert adapter.asked == [pytest.approx(asked)]
    assert made.start == pytest.approx(BEGIN + asked + 0.4)


def test_a_clock_that_stands_still_is_not_waited_for_without_end(clock: Clock) -> None:
    asked = values(Problem, delay=0.1)
    clock.now = lambda: BEGIN  # type: ignore[method-assign]
    make_plan(Problem, asked, Adapter(0.1), clock)  # type: ignore[arg-type]
    assert clock.passed == pytest.approx(2 * 0.4, abs=0.01)


def test_what_begins_sooner_is_not_begun_too_late() -> None:
    """Half the delay has passed when the first attempt fails: no time is left for the others."""
    made = failure(Distant)
    assert made.code == 'INFEASIBLE'
    assert 'predicted from the measured state for 0.4 s later' in made.reason
    Problem.clock.passed = 0.0
    plan(Distant, delay=0.56)


@pytest.mark.parametrize('source', ['measured', 'parameters'])
def test_a_start_that_can_be_put_off_is_not_in_the_past(source: str) -> None:
    made = plan(Slow, Adapter(rests=True), source=source)
    assert made.start - BEGIN == pytest.approx(2.0 + 0.5 * 0.4)


def test_a_start_of_a_plant_in_motion_is_not_put_off() -> None:
    made = make_plan(Slow, values(Slow), Adapter(), Problem.clock)  # type: ignore[arg-type]
    assert made.start - BEGIN == pytest.approx(0.4)


@pytest.mark.parametrize('error', [Infeasible, DeadlineExceeded])
def test_an_attempt_leaves_time_for_what_begins_sooner(error: type[Exception]) -> None:
    made = plan(type('Late', (Late,), {'error': error}), delay=0.8)
    assert made.start == pytest.approx(BEGIN + 0.2)
    assert Problem.clock.passed == pytest.approx(0.1)


@pytest.mark.parametrize(('error', 'asked'), [(InvalidProblem, 3), (DeadlineExceeded, 1)])
def test_only_what_a_sooner_start_may_mend_is_tried_again(error: Any, asked: int) -> None:
    adapter = Adapter()
    failure(type('Faulty', (Faulty,), {'error': error('it is so')}), adapter)
    assert len(adapter.asked) == asked


def test_the_first_attempt_says_why_there_is_no_plan() -> None:
    """Not the last, that had the least time."""
    made = failure(Lost, delay=0.8)
    assert made.code == 'INFEASIBLE'
    assert 'there is no way from this start' in made.reason


@pytest.mark.parametrize(('cost', 'told'), [(np.float32(1.5), 1.5), (math.nan, None)])
def test_the_answer_is_json_whatever_a_problem_of_ones_own_returns(cost: Any, told: Any) -> None:
    made = ActivePlan(Problem({}), solution(cost=cost), BEGIN)  # type: ignore[arg-type]
    answer = json.loads(plan_answer(made, 1), parse_constant=pytest.fail)
    assert answer['cost'] == told

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""From parameters and a measured state to a plan or the reason for none, without ROS running."""

from collections.abc import Mapping
import json
import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from tdm_planner.exceptions import DeadlineExceeded, Failure, Infeasible, InvalidProblem, NoState
from tdm_planner.nodes import planning
from tdm_planner.parameters import to_mapping
from tdm_planner.problems.planner_parameters import PlannerParameters, StartParameters
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.plan_reports import plan_answer
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Verification

BEGIN = 1_700.0  # s


class Clock:
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


def adapter(begins: float = -1.0, comes: float = 0.0, may_start_later: bool = False):
    """Return one that is asked how far ahead; a plan begins at `begins`, a state comes [s]."""
    made, begin = Mock(asked=[]), BEGIN + begins

    def measured_start(values, now: float, start: float) -> dict:
        made.asked.append(now - BEGIN)
        return {'start.x': start - now}

    made.measured_start, made.may_start_later.return_value = measured_start, may_start_later
    made.pending_start = lambda now: begin if begin > now else None
    made.missing = lambda: [] if Problem.clock.passed >= comes else ['no state was received here']
    return made


def solution(ok: bool = True, cost: float = 1.0) -> Solution:
    check = Verification(ok, np.zeros(1), reasons=() if ok else ('it hits the wall',))
    motion = Trajectory(np.arange(2), np.zeros((2, 1)), np.zeros((2, 1)), ('x',), ('u',))
    return Solution({'plant': motion}, check, cost, np.zeros(0), 0.0, summary='a plan')


class Problem:
    """Solved at once; .3 s are allowed; the start is `ahead` s from now."""

    clock: Clock
    ahead, solver = 0.0, SimpleNamespace(deadline=0.3)

    @classmethod
    def from_parameters(cls, values: Mapping):
        made = cls()
        made.ahead = values.get('start.x', 0.0)
        return made

    def solve(self, deadline: float):
        return solution()


def solved_by(search):
    """Return one whose `search` returns the plan or nothing, or raises why there is none."""
    found = {'solve': lambda self, deadline: search(self, deadline) or solution()}
    return type('Own', (Problem,), found)


def raising(error: Exception):
    return solved_by(Mock(side_effect=error))


@solved_by
def distant(self, deadline: float):
    self.clock.sleep(min(0.25, 0.8 * deadline))
    if self.ahead > 0.3:
        raise Infeasible('there is no way from this start')


slow = solved_by(lambda self, deadline: self.clock.sleep(2.0))


def late(error: type[Exception], never: bool = False):
    """Return one without a way far ahead; nearer, or `never`, none is found in all the time."""

    def search(self, deadline: float):
        if self.ahead > 0.7:
            raise Infeasible('there is no way from this start')
        if self.ahead > 0.3:
            self.clock.sleep(deadline)
        if self.ahead > 0.3 or never:
            raise error('nothing was found')

    return solved_by(search)


def plan(kind=Problem, there=None, **start):
    parameters = PlannerParameters(start=StartParameters(**{'delay': 0.4, **start}))
    values = to_mapping(parameters) | {'solver.deadline': 0.3}
    return planning.make_plan(kind, values, there or adapter(), Problem.clock)


def failure(kind, there=None, **start) -> Failure:
    with pytest.raises(Exception) as raised:  # noqa: PT011
        plan(kind, there, **start)
    return Failure.of(raised.value)


@pytest.mark.parametrize('source', ['measured', 'parameters'])
def test_what_its_own_check_objects_to_is_no_plan(source):
    made = failure(solved_by(lambda self, deadline: solution(ok=False)), source=source)
    assert made.code == 'VERIFICATION_FAILED'
    assert 'it hits the wall' in made.reason


def test_a_clock_that_stands_still_is_not_waited_for_without_end(clock):
    clock.now = lambda: BEGIN
    plan(Problem, adapter(0.1), delay=0.1)
    assert clock.passed == pytest.approx(2 * 0.4, abs=0.01)
    clock.runs = False  # without time there is no plan
    with pytest.raises(NoState, match='/clock'):
        plan(source='parameters')


@pytest.mark.parametrize(('begins', 'asked'), [(0.2, 0.2), (0.399, 0.4), (0.41, 0.0)])
def test_a_plan_that_may_begin_meanwhile_is_waited_for(begins, asked):
    """One that begins later is replaced before: the deadline of .3 s and .1 s to publish it."""
    there = adapter(begins)
    made = plan(Problem, there)
    assert there.asked == [pytest.approx(asked)]
    assert made.start == pytest.approx(BEGIN + asked + 0.4)


def test_what_begins_sooner_is_not_begun_too_late(clock):
    """Half the delay has passed when the first attempt fails: no time is left for the others."""
    made = failure(distant)
    assert made.code == 'INFEASIBLE'
    assert 'predicted from the measured state for 0.4 s later' in made.reason
    clock.passed = 0.0
    assert plan(distant, delay=0.56).start >= clock.now()


@pytest.mark.parametrize('source', ['measured', 'parameters'])
def test_a_start_is_put_off_beyond_the_present_unless_the_plant_moves(source):
    made = plan(slow, adapter(may_start_later=True), source=source)
    assert made.start - BEGIN == pytest.approx(2.0 + 0.5 * 0.4)
    moving = plan(slow)
    assert moving.start - BEGIN == pytest.approx(2.0 + 0.4)


@pytest.mark.parametrize('error', [Infeasible, DeadlineExceeded])
def test_an_attempt_leaves_time_for_what_begins_sooner(clock, error):
    made = plan(late(error), delay=0.8)
    assert made.start == pytest.approx(BEGIN + 0.2)
    told = 'a plan; begins 0.2 s ahead, as there is no plan for start.delay'
    assert [made.solution.summary, plan().solution.summary] == [told, 'a plan']
    assert clock.passed == pytest.approx(0.1)
    # the first attempt says why there is no plan: the last had the least time
    made = failure(late(error, never=True), delay=0.8)
    assert made.code == 'INFEASIBLE'
    assert 'there is no way from this start' in made.reason


def test_a_state_that_is_too_old_after_a_failure_does_not_hide_why_there_is_no_plan():
    there, began = adapter(), Problem.clock.now()
    measured_start = there.measured_start

    def fresh_for_a_tenth(values, now: float, start: float) -> dict:
        if now - began > 0.1:
            raise NoState('the newest state is too old')
        return measured_start(values, now, start)

    there.measured_start = fresh_for_a_tenth
    assert failure(distant, there, delay=2.0).code == 'INFEASIBLE'
    began -= 1.0
    assert failure(distant, there, delay=2.0).code == 'NO_STATE'


@pytest.mark.parametrize(('error', 'asked'), [(InvalidProblem, 3), (DeadlineExceeded, 1)])
def test_only_what_a_sooner_start_may_mend_is_tried_again(error, asked):
    there = adapter()
    failure(raising(error('it is so')), there)
    assert len(there.asked) == asked


@pytest.mark.parametrize(('cost', 'told'), [(np.float32(1.5), 1.5), (math.nan, None)])
def test_the_answer_is_json_whatever_a_problem_of_ones_own_returns(cost, told):
    made = TimedPlan(Problem(), solution(cost=cost), BEGIN)
    answer = json.loads(plan_answer(made, 1), parse_constant=pytest.fail)
    assert answer['cost'] == told

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""When the active plan is replaced: decisions, single reviews, plans that trackers refuse."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from closed_loop import crossing, FORMATION, SWING, swing_up
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.pendulum.task import VEHICLE
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning import (
    ActivePlan,
    FormationExecution,
    Mode,
    Observation,
    Replanner,
    SwingUpExecution,
)
from tdm_planner.replanning.execution import decide, LEAST_LEFT, Outlook, worth_improving
from tdm_planner.verification import Verification

SETTINGS = settings(max_examples=100)
COSTS, SHARES = st.floats(0.0, 100.0), st.floats(0.0, 1.0)
OUTLOOKS = st.builds(
    Outlook, cost=COSTS, failure=st.sampled_from(['', 'it falls']), settled=st.booleans()
)
PARAMETERS = ReplanParameters(rate=5.0, delay=0.4)


@SETTINGS
@given(OUTLOOKS, st.booleans(), SHARES, st.sampled_from([True, False, None]), st.floats(0.0, 2.0))
def test_a_verified_plan_takes_over_if_it_is_necessary_or_saves_its_share(
    outlook: Outlook, changed: bool, improvement: float, verified: bool | None, ratio: float
) -> None:
    new, cost = None, ratio * outlook.cost
    if verified is not None:
        check = Verification(ok=verified, terminal_error=np.zeros(4))
        new = Solution({}, check, cost, np.zeros(1), 0.0, problem='test')
    decision = decide(outlook, changed, new, improvement)
    assert decision.reason
    if not verified:
        assert not decision.take_over
    elif changed or outlook.failure:
        assert decision.take_over
    elif abs(ratio - (1.0 - improvement)) > 1e-9:
        saves = outlook.cost > 0.0 and ratio < 1.0 - improvement
        assert decision.take_over == saves


@SETTINGS
@given(OUTLOOKS, st.floats(0.1, 100.0), SHARES)
def test_near_the_goal_nothing_better_is_looked_for(
    outlook: Outlook, whole: float, improvement: float
) -> None:
    far = outlook.cost > LEAST_LEFT * whole
    wanted = far and improvement < 1.0 and not outlook.settled
    assert worth_improving(outlook, whole, improvement) == wanted


@pytest.fixture(scope='module')
def swing() -> ActivePlan:
    return swing_up()


@pytest.fixture
def replanner(swing: ActivePlan) -> Replanner:
    made = Replanner(SwingUpExecution(SWING), PARAMETERS)
    made.adopt(swing)
    return made


def following(plan: ActivePlan, at: float) -> dict[str, Observation]:
    """Return what is seen of a pendulum whose tracker says that it follows `plan`."""
    reference = plan.solution.trajectory.sample(plan.elapsed(at)).state
    return {VEHICLE: Observation(reference, at, Mode.FOLLOWING, plan.start)}


def test_another_question_is_answered_at_once(swing: ActivePlan, replanner: Replanner) -> None:
    at = 0.1
    assert replanner.review(SWING, following(swing, at), at).plan is None
    wanted = 1 - round(swing.solution.trajectory.states[-1, 0] / math.tau)
    other = replace(SWING, goal=replace(SWING.goal, turns=wanted))
    review = replanner.review(other, following(swing, at), at)
    assert review.necessary
    assert review.plan is not None, review.reason
    assert review.plan.start == pytest.approx(at + PARAMETERS.delay)
    last = review.plan.solution.trajectory.states[-1]
    assert last[0] == pytest.approx(math.tau * wanted, abs=1e-3)


def test_a_plan_that_has_not_begun_is_left_alone(swing: ActivePlan) -> None:
    replanner = Replanner(SwingUpExecution(SWING), PARAMETERS)
    seen = {VEHICLE: Observation(np.zeros(4), 0.0, Mode.IDLE)}
    assert replanner.review(SWING, seen, 0.0).plan is None
    replanner.adopt(replace(swing, start=1.0))
    assert replanner.review(SWING, seen, 0.0).plan is None


def test_a_state_beyond_the_limits_keeps_the_plan_and_says_why(replanner: Replanner) -> None:
    seen = {VEHICLE: Observation(np.array([3.0, 5.0, 0.0, 0.0]), 0.5, Mode.IDLE)}
    review = replanner.review(SWING, seen, 0.5)
    assert review.plan is None
    assert review.necessary
    assert 'INVALID_PROBLEM' in review.reason


@pytest.mark.parametrize('mode', [Mode.FOLLOWING, Mode.RECOVERING])
def test_where_the_plan_is_followed_its_rest_is_the_first_guess(
    swing: ActivePlan, replanner: Replanner, monkeypatch: pytest.MonkeyPatch, mode: Mode
) -> None:
    guesses = []
    solve = PendulumSwingUp.solve

    def noted(self: PendulumSwingUp, *args: Any, **options: Any) -> Any:
        guesses.append(options['warm_start'])
        return solve(self, *args, **options)

    monkeypatch.setattr(PendulumSwingUp, 'solve', noted)
    at = 0.3
    state = swing.solution.trajectory.sample(at).state + np.array([0.1, 0.0, 1.0, 0.0])
    replanner.review(SWING, {VEHICLE: Observation(state, at, mode)}, at)
    rest = swing.remainder(at + PARAMETERS.delay)
    assert rest is not None
    (guess,) = guesses
    if mode is Mode.RECOVERING:
        assert guess is None
    else:
        left = guess.trajectory
        np.testing.assert_array_equal(left.times, rest.trajectory.times)
        np.testing.assert_array_equal(left.states, rest.trajectory.states)


def test_the_plan_that_is_followed_is_the_one_that_the_tracker_names(swing: ActivePlan) -> None:
    execution, later = SwingUpExecution(SWING), replace(swing, start=0.5)
    silent = {VEHICLE: replace(following(swing, 0.9)[VEHICLE], followed=None)}
    assert execution.keeping(swing, later, following(swing, 0.9)) == [VEHICLE]
    assert not execution.keeping(swing, later, following(later, 0.9))
    assert not execution.keeping(swing, later, silent)


def test_a_plan_that_all_refuse_is_forgotten_once_it_has_begun_for_a_while(
    swing: ActivePlan, replanner: Replanner
) -> None:
    later = replace(swing, start=0.5)
    replanner.adopt(later)
    early = replanner.review(SWING, following(swing, 0.51), 0.52)
    assert (early.plan, early.rejected, replanner.plan) == (None, (), later)
    seen = following(swing, 0.9)
    review = replanner.review(SWING, seen, 0.9)
    assert review.rejected == (VEHICLE,)
    assert replanner.plan is swing
    assert replanner.review(SWING, following(swing, 0.91), 0.91).rejected == ()
    assert not review.necessary
    assert not replanner.review(SWING, seen, 0.9).rejected


def test_the_robots_that_keep_their_plan_are_named_and_it_is_mended() -> None:
    first, at = crossing(), 8.0
    later = replace(first, start=3.0)
    plans = {'robot1': first, 'robot2': later, 'robot3': later}
    seen = {}
    for name, plan in plans.items():
        state = plan.solution.trajectories[name].sample(plan.elapsed(at)).state
        seen[name] = Observation(state, at, Mode.FOLLOWING, plan.start)
    replanner = Replanner(FormationExecution(FORMATION), ReplanParameters(rate=5.0, delay=3.0))
    replanner.adopt(first)
    replanner.adopt(later)
    review = replanner.review(FORMATION, seen, at)
    assert review.rejected == ('robot1',)
    assert review.necessary
    assert 'robot1' in review.outlook.failure
    assert replanner.plan is later

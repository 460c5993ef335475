# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""When the active plan is replaced; problems without a model of their tracker."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

from closed_loop import crossing, FORMATION, seen, states_on, SWING, swing_up
from double_integrator import CartStart, DoubleIntegrator
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from stated import noted
from tdm_planner.exceptions import VerificationFailed
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectSolverParameters, PendulumSwingUp, RobotFormation
from tdm_planner.problems.pendulum.task import PENDULUM_NAME
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.replanning import replanner as reviewing
from tdm_planner.replanning.execution import GenericExecution, Outlook, PLANT_NAME, TimedPlan
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.replanner import PublishedPlans, Replanner
from tdm_planner.replanning.swing_up_execution import SwingUpExecution
from tdm_planner.tracking.motion import ObservedPhase

COSTS, SHARES = st.floats(0.0, 100.0), st.floats(0.0, 1.0)
FAILURES = st.sampled_from(['', 'it falls'])
OUTLOOKS = st.builds(Outlook, cost=COSTS, failure=FAILURES, settled=st.booleans())
PARAMETERS = ReplanParameters(rate=5.0, delay=0.4)


@settings(max_examples=100)
@given(OUTLOOKS, st.booleans(), SHARES, st.floats(0.0, 2.0))
def test_a_plan_supersedes_if_needed_or_cheaper(outlook, changed, improvement, ratio):
    supersedes, reason = reviewing.decide(outlook, changed, ratio * outlook.cost, improvement)
    assert reason
    if changed or outlook.failure:
        assert supersedes
    elif abs(ratio - (1.0 - improvement)) > 1e-9:
        saves = outlook.cost > 0.0 and ratio < 1.0 - improvement
        assert supersedes == saves


@settings(max_examples=100)
@given(OUTLOOKS, st.floats(0.1, 100.0), SHARES)
def test_near_the_goal_nothing_better_is_looked_for(outlook, whole, improvement):
    far = outlook.cost > reviewing.LEAST_LEFT * whole
    wanted = far and improvement < 1.0 and not outlook.settled
    plan = SimpleNamespace(whole_cost=whole, solution=SimpleNamespace(duration=1.0))
    parameters = replace(PARAMETERS, improvement=improvement)
    replanner = Replanner(SimpleNamespace(plan=plan), parameters)
    assert replanner._may_improve(outlook, 0.0) == wanted
    assert not replanner._may_improve(outlook, 0.05)  # not so soon again


swing = pytest.fixture(swing_up, scope='module', name='swing')


@pytest.fixture
def replanner(swing) -> Replanner:
    return Replanner(SwingUpExecution(swing), PARAMETERS)


def test_a_state_beyond_the_limits_keeps_the_plan_and_says_why(replanner) -> None:
    beyond = seen({PENDULUM_NAME: np.array([3.0, 5.0, 0.0, 0.0])}, 0.5, ObservedPhase.IDLE)
    review = replanner.review(SWING, beyond, 0.5)
    assert (review.plan, review.necessary) == (None, True)
    assert 'INVALID_PROBLEM' in review.reason


def test_the_plan_that_trackers_name_is_reviewed_once_the_newest_has_begun_for_a_while(swing):
    plans, later = PublishedPlans(), replace(swing, start=0.5)

    def reviewed(now: float, *starts: float | None) -> tuple[TimedPlan | None, str]:
        states = {str(k): np.zeros(4) for k in range(len(starts))}
        told = {k: seen({k: x}, now, followed=starts[int(k)])[k] for k, x in states.items()}
        return plans.reviewed(told, now)

    assert reviewed(0.0, None) == (None, 'no plan is under way')
    plans.add(swing)
    plans.add(later)
    assert reviewed(0.4, 0.0) == (None, 'no plan is under way')
    assert reviewed(0.52, 0.0) == (None, 'the newest plan is not followed yet')
    assert reviewed(0.9, 0.0, 0.0) == (swing, '')
    assert reviewed(0.9, 0.5, 0.5) == reviewed(0.9, None, 0.5) == (later, '')
    for follow in ((0.5, 0.0), (None, 0.0)):
        assert reviewed(0.9, *follow) == (later, "'1' has kept the plan before the active one")
    assert reviewed(0.9, 0.5, 0.7) == (None, "'1' follows the plan of another planner")


def test_a_plan_that_a_robot_has_not_taken_is_mended() -> None:
    plan, at = replace(crossing(), start=3.0), 8.0
    replanner = Replanner(FormationExecution(plan), ReplanParameters(rate=5.0, delay=3.0))
    review = replanner.review(FORMATION, seen(states_on(plan, at), at), at, 'it was kept')
    assert (review.necessary, 'it was kept' in review.reason) == (True, True)


@pytest.mark.parametrize('phase', [ObservedPhase.FOLLOWING, ObservedPhase.RECOVERING])
def test_the_rest_of_a_followed_plan_is_the_first_guess(swing, replanner, monkeypatch, phase):
    solve, at = noted(monkeypatch, PendulumSwingUp, 'solve'), 0.3
    pushed = seen(states_on(swing, at), at, phase, pendulum=[0.1, 0, 1.0, 0])
    replanner.review(SWING, pushed, at)
    guesses = [call.kwargs['warm_start'] for call in solve.call_args_list]
    if phase is ObservedPhase.RECOVERING:
        assert guesses == [None]
    else:
        rest = swing.remainder(at + PARAMETERS.delay).trajectory
        (left,) = (guess.trajectory for guess in guesses)
        np.testing.assert_array_equal(left.times, rest.times)
        np.testing.assert_array_equal(left.states, rest.states)


@dataclass(frozen=True)
class Cart(DoubleIntegrator):
    name: ClassVar[str] = 'test_cart'
    nodes, starts = 101, 1  # one initial guess, and no refinement: quick even on a busy machine
    free: int = parameter(3, 'varied parameters')
    weight: float = parameter(0.0, 'of the force')

    def running_cost(self, t: Any, x: Any, u: Any) -> Any:
        return self.weight * u[0] ** 2


CART = Cart(weight=0.2)
FAR = Cart(start=CartStart(x=-1600.0))  # so that a busy machine does not decide the outcome


@pytest.fixture(scope='module')
def plan() -> TimedPlan:
    return TimedPlan(CART, CART.solve(deadline=10.0), start=10.0)


def measured(plan: TimedPlan, at: float, x: float = 0.0, v: float = 0.0) -> Any:
    """Return what is measured so far away: velocity first, to show that names decide."""
    (state,) = states_on(plan, at).values()
    return seen({PLANT_NAME: np.add(state, [x, v])[::-1]}, at)


def reviewer(plan: TimedPlan, delay: float = 0.3) -> Replanner:
    parameters = ReplanParameters(rate=5.0, delay=delay)
    return Replanner(GenericExecution(plan, ('v', 'x'), parameters.deviation), parameters)


def test_the_cost_of_the_rest_is_that_of_the_whole_less_what_is_done(plan: TimedPlan) -> None:
    problem, solution = plan.problem, plan.solution
    assert problem.cost_to_go(solution, 0.0) == pytest.approx(solution.cost, rel=1e-3)
    assert problem.cost_to_go(solution, solution.duration) == 0.0
    half = 0.5 * solution.duration
    motion = solution.trajectory.after(half)
    force = motion.controls[:, 0]
    squares = force[1:] ** 2 + force[1:] * force[:-1] + force[:-1] ** 2
    used = 0.2 * float(np.sum(np.diff(motion.times) * squares / 3))  # linear between samples
    assert problem.cost_to_go(solution, half) == pytest.approx(half + used, rel=1e-6)


def test_a_plan_that_is_followed_is_kept_whatever_start_or_solver_is_set(plan: TimedPlan) -> None:
    made = reviewer(plan)
    for share in (0.1, 0.6, 0.9):
        at = plan.start + share * plan.solution.duration
        review = made.review(plan.problem, measured(plan, at, 0.01, 0.01), at)
        assert (review.plan, review.necessary) == (None, False)
    at = plan.end + 0.1
    review = made.review(replace(CART, limit=2.0), measured(plan, at, 1.0), at)
    assert (review.plan, review.necessary) == (None, False)
    solver = DirectSolverParameters(deadline=1.0, seed=3)
    other = replace(CART, start=CartStart(x=3.0), solver=solver)
    assert reviewing.is_same_task(plan.problem, other)
    assert not reviewing.is_same_task(plan.problem, replace(CART, limit=2.0))


def test_a_plan_that_its_tracker_has_given_up_is_replaced_from_where_nothing_leads(plan) -> None:
    """However near the plant is; what is commanded after an abort is nothing."""
    execution = GenericExecution(plan, ('x', 'v'), 0.05)
    at, later = plan.start + 0.4, plan.start + 0.7
    ((x, v),) = states_on(plan, at).values()
    now = seen({PLANT_NAME: np.array([x, v])}, at, ObservedPhase.IDLE)
    predicted = execution.predict(now, later)
    np.testing.assert_allclose(predicted[PLANT_NAME].state, [x + 0.3 * v, v], atol=1e-9)
    assert 'is not followed' in execution.outlook(predicted, later).failure


@pytest.mark.parametrize('margin', [0.03, 0.1, 0.2])
def test_a_push_towards_a_goal_just_as_far_away_as_allowed_is_seen(margin: float) -> None:
    values = {'robots': ['robot1', 'robot2'], 'arena.tracking_margin': margin}
    values |= {'formation.anchor': [0.0, 2.0, 0.0], 'formation.robot2': [2.0, 0.0, 0.0]}
    problem = RobotFormation.from_parameters(values | {'formation.robot1': [1.6, 0.0, 0.0]})
    made = TimedPlan(problem, problem.solve(counted=True), 0.0)
    execution, at = FormationExecution(made), 0.9 * made.end
    for speed in (0.0, 0.03):
        states = states_on(made, at)
        states['robot1'][2] += speed
        failure = execution.outlook(execution.predict(seen(states, at), at), at).failure
        assert bool(failure) == (speed > 0.0), failure


def test_a_state_that_left_the_plan_makes_another_necessary() -> None:
    plan = TimedPlan(FAR, FAR.solve(deadline=10.0), start=10.0)
    at, delay = plan.start + 10.0, 10.0
    review = reviewer(plan, delay).review(FAR, measured(plan, at, -200.0), at)
    assert review.necessary
    assert "'x' is 200 m away from the active plan" in review.reason
    assert review.plan is not None, review.reason
    assert review.plan.start == pytest.approx(at + delay)
    assert review.plan.solution.verification.ok
    # It begins where the planned force will have brought the cart, not where it was.
    ahead = plan.solution.trajectory.sample(plan.elapsed(at + delay)).state
    first = review.plan.solution.trajectory.states[0]
    np.testing.assert_allclose(first, ahead + np.array([-200.0, 0.0]), atol=2.0)


def test_where_not_all_is_measured_the_deviation_is_carried_along(plan: TimedPlan) -> None:
    execution, at = GenericExecution(plan, ('x',), 0.05), plan.start + 0.4
    (state,) = states_on(plan, at).values()
    predicted = execution.predict(seen({PLANT_NAME: state[:1] + 0.1}, at), at + 0.3)
    expected = plan.solution.trajectory.sample(0.7).state[0] + 0.1
    assert predicted[PLANT_NAME].state[0] == pytest.approx(expected, abs=1e-9)
    assert "'x'" in execution.outlook(predicted, at + 0.3).failure


def test_a_cheaper_plan_takes_over_and_another_question_is_answered() -> None:
    # The plan of a weaker cart, taken for this one's: half of the time would do.
    lazy = TimedPlan(FAR, replace(FAR, limit=0.3).solve(deadline=10.0), start=0.0)
    made, at = reviewer(lazy, delay=10.0), 0.1
    review = made.review(FAR, measured(lazy, at), at)
    assert not review.necessary
    assert review.plan is not None, review.reason
    assert 'saves' in review.reason
    asked = replace(FAR, limit=2.0)
    review = made.review(asked, measured(lazy, at), at)
    assert review.necessary
    assert review.reason == 'the problem has changed'


def test_where_the_cost_to_go_is_not_known_only_necessary_plans_are_made(plan, monkeypatch):
    monkeypatch.setattr(Cart, 'cost_to_go', lambda *_: None)
    made, at = reviewer(plan), plan.start + 0.1
    review = made.review(plan.problem, measured(plan, at), at)
    assert (review.plan, review.reason) == (None, 'the active plan does')  # nothing is solved


def test_a_plan_that_did_not_pass_its_check_takes_nothing_over(plan, monkeypatch):
    """As of a user's problem that solves itself; reviews publish, too."""
    unproven = replace(plan.solution.verification, ok=False, reasons=('it hits the wall',))
    solved = replace(plan.solution, verification=unproven)
    monkeypatch.setattr(Cart, 'solve', lambda *_, **__: solved)
    at = plan.start + 0.1
    with pytest.raises(VerificationFailed, match='it hits the wall'):
        reviewer(plan).review(replace(CART, limit=2.0), measured(plan, at), at)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Problems without a model of their tracker: the same decision by what can be measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from double_integrator import CartStart, DoubleIntegrator
import numpy as np
import pytest
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectSolverParameters
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import ActivePlan, GenericExecution, Mode, Observation, Replanner
from tdm_planner.replanning.generic_execution import VEHICLE

PARAMETERS = ReplanParameters(rate=5.0, delay=0.3)


@dataclass(frozen=True)
class Cart(DoubleIntegrator):
    """The tutorial's cart to the origin, with a weight on the force."""

    name: ClassVar[str] = 'test_cart'
    nodes, starts = 101, 1  # one first guess, and no refinement: quick even on a busy machine

    free: int = parameter(3, 'varied parameters')
    weight: float = parameter(0.0, 'of the force')

    def running_cost(self, t: Any, x: Any, u: Any) -> Any:
        return self.weight * u[0] ** 2


CART = Cart(weight=0.2)
FAR = Cart(start=CartStart(x=-1600.0))  # so that a busy machine does not decide the outcome


@pytest.fixture(scope='module')
def plan() -> ActivePlan:
    return ActivePlan(CART, CART.solve(deadline=10.0), start=10.0)


def seen(plan: ActivePlan, at: float, away: Sequence[float] = (0.0, 0.0)) -> Any:
    """Return what is measured at an instant: velocity first, to show that names decide."""
    x, v = (plan.solution.trajectory.sample(plan.elapsed(at)).state + np.array(away)).tolist()
    return {VEHICLE: Observation(np.array([v, x]), at, Mode.FOLLOWING)}


def replanner(plan: ActivePlan, names: Sequence[str] = ('v', 'x')) -> Replanner:
    made = Replanner(GenericExecution(names, PARAMETERS.deviation), PARAMETERS)
    made.adopt(plan)
    return made


def test_the_cost_of_the_rest_is_that_of_the_whole_less_what_is_done(plan: ActivePlan) -> None:
    problem, solution = plan.problem, plan.solution
    assert problem.cost_to_go(solution, 0.0) == pytest.approx(solution.cost, rel=1e-3)
    assert problem.cost_to_go(solution, solution.duration) == 0.0
    half = 0.5 * solution.duration
    motion = solution.trajectory.after(half)
    force = motion.controls[:, 0]
    squares = force[1:] ** 2 + force[1:] * force[:-1] + force[:-1] ** 2
    used = 0.2 * float(np.sum(np.diff(motion.times) * squares / 3))  # linear between samples
    assert problem.cost_to_go(solution, half) == pytest.approx(half + used, rel=1e-6)


def test_a_plan_that_is_followed_is_kept(plan: ActivePlan) -> None:
    made = replanner(plan)
    for share in (0.1, 0.6, 0.9):
        at = plan.start + share * plan.solution.duration
        review = made.review(plan.problem, seen(plan, at, (0.01, 0.01)), at)
        assert (review.plan, review.necessary) == (None, False)
    # after its end it is not active
    at = plan.end + 0.1
    review = made.review(replace(CART, limit=2.0), seen(plan, at, (1.0, 0.0)), at)
    assert (review.plan, review.necessary) == (None, False)


def test_a_state_that_left_the_plan_makes_another_necessary() -> None:
    plan = ActivePlan(FAR, FAR.solve(deadline=10.0), start=10.0)
    made, delay = replanner(plan), 10.0
    made.parameters = replace(PARAMETERS, delay=delay)
    at = plan.start + 10.0
    review = made.review(FAR, seen(plan, at, (-200.0, 0.0)), at)
    assert review.necessary
    assert "'x' is 200 m away from the active plan" in review.outlook.failure
    assert review.plan is not None, review.reason
    assert review.plan.start == pytest.approx(at + delay)
    assert review.plan.solution.verification.ok
    # It begins where the planned force will have brought the cart, not where it was.
    ahead = plan.solution.trajectory.sample(plan.elapsed(at + delay)).state
    first = review.plan.solution.trajectory.states[0]
    np.testing.assert_allclose(first, ahead + np.array([-200.0, 0.0]), atol=2.0)


def test_where_not_all_is_measured_the_deviation_is_carried_along(plan: ActivePlan) -> None:
    execution, at = GenericExecution(('x',), 0.05), plan.start + 0.4
    x = float(plan.solution.trajectory.sample(0.4).state[0])
    observed = {VEHICLE: Observation(np.array([x + 0.1]), at, Mode.FOLLOWING)}
    predicted = execution.predict(plan, observed, at + 0.3)
    expected = plan.solution.trajectory.sample(0.7).state[0] + 0.1
    assert predicted[VEHICLE].state[0] == pytest.approx(expected, abs=1e-9)
    assert "'x'" in execution.outlook(plan, predicted, at + 0.3).failure


def test_a_cheaper_plan_takes_over_and_another_question_is_answered() -> None:
    # The plan of a weaker cart, taken for this one's: half of the time would do.
    lazy = ActivePlan(FAR, replace(FAR, limit=0.3).solve(deadline=10.0), start=0.0)
    made, at = replanner(lazy), 0.1
    made.parameters = replace(PARAMETERS, delay=10.0)
    review = made.review(FAR, seen(lazy, at), at)
    assert not review.necessary
    assert review.plan is not None, review.reason
    assert 'saves' in review.reason
    asked = replace(FAR, limit=2.0)
    review = made.review(asked, seen(lazy, at), at)
    assert review.necessary
    assert review.reason == 'the problem has changed'


def test_another_start_or_solver_is_not_another_question(plan: ActivePlan) -> None:
    execution = GenericExecution(('x', 'v'), 0.05)
    other = replace(
        CART, start=CartStart(x=3.0), solver=DirectSolverParameters(deadline=1.0, seed=3)
    )
    assert execution.same_question(plan.problem, other)
    assert not execution.same_question(plan.problem, replace(CART, limit=2.0))


def test_where_the_cost_to_go_is_not_known_only_necessary_plans_are_made(
    plan: ActivePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cart, 'cost_to_go', lambda *_: None)
    made, at = replanner(plan), plan.start + 0.1
    review = made.review(plan.problem, seen(plan, at), at)
    assert review.plan is None
    assert review.solve_time == 0.0

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, ClassVar

import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Output
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problems import DirectProblem, DirectSolverParameters
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import GenericExecution, Mode, Observation, PlanInForce, Replanner
from tdm_planner.replanning.generic_execution import VEHICLE

PARAMETERS = ReplanParameters(rate=5.0, delay=0.3)


@dataclass(frozen=True)
class Start(Validated):
    x: float = parameter(-1.0, 'position', unit='m')
    v: float = parameter(0.0, 'velocity', unit='m/s')


@dataclass(frozen=True)
class Cart(DirectProblem, Validated):
    """A cart to the origin, with a weight on the force."""

    name: ClassVar[str] = 'test_cart'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)
    nodes, starts = 101, 1  # one first guess, and no refinement: quick even on a busy machine

    start: Start = group(Start)
    limit: float = parameter(1.0, 'largest acceleration', unit='m/s^2', allowed=POSITIVE)
    weight: float = parameter(0.0, 'of the force')
    free: int = parameter(3, 'varied parameters')
    solver: DirectSolverParameters = group(DirectSolverParameters)

    def outputs(self) -> Mapping[str, Output]:
        return {'x': Output(start=(self.start.x, self.start.v), end=(0.0, 0.0), free=self.free)}

    def duration(self) -> Duration:
        return Duration(guess=3.0 * math.sqrt(abs(self.start.x) / self.limit) + 0.1)

    def invert(self, y: Any, z: Any) -> tuple[Sequence[Any], Sequence[Any]]:
        x, v, u = y['x']
        return (x, v), (u,)

    def derivative(self, x: Any, u: Any) -> Sequence[Any]:
        return x[1], u[0]

    def margins(self, t: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {'push': 1.0 - u[0] / self.limit, 'pull': 1.0 + u[0] / self.limit}

    def final_cost(self, t: Any, x: Any) -> Any:
        return t

    def running_cost(self, t: Any, x: Any, u: Any) -> Any:
        return self.weight * u[0] ** 2


@pytest.fixture(scope='module')
def plan() -> PlanInForce:
    problem = Cart(weight=0.2)
    return PlanInForce(problem, problem.solve(deadline=10.0), start=10.0)


def cart(plan: PlanInForce) -> Cart:
    assert isinstance(plan.problem, Cart)
    return plan.problem


def seen(plan: PlanInForce, at: float, away: Sequence[float] = (0.0, 0.0)) -> Any:
    """Return what is measured at an instant: velocity first, to show that names decide."""
    x, v = (plan.solution.trajectory.sample(plan.elapsed(at)).state + np.array(away)).tolist()
    return {VEHICLE: Observation(np.array([v, x]), at, Mode.FOLLOWING)}


def replanner(plan: PlanInForce, names: Sequence[str] = ('v', 'x')) -> Replanner:
    made = Replanner(GenericExecution(names, PARAMETERS.deviation), PARAMETERS)
    made.adopt(plan)
    return made


def test_the_cost_of_the_rest_is_that_of_the_whole_less_what_is_done(plan: PlanInForce) -> None:
    problem, solution = plan.problem, plan.solution
    assert problem.cost_to_go(solution, 0.0) == pytest.approx(solution.cost, rel=1e-3)
    assert problem.cost_to_go(solution, solution.duration) == 0.0
    half = 0.5 * solution.duration
    motion = solution.trajectory.after(half)
    force = motion.controls[:, 0]
    used = 0.2 * float(np.sum(np.diff(motion.times) * (force[1:] ** 2 + force[:-1] ** 2) / 2))
    assert problem.cost_to_go(solution, half) == pytest.approx(half + used, rel=1e-6)


def test_a_plan_that_is_followed_is_kept(plan: PlanInForce) -> None:
    made = replanner(plan)
    for share in (0.1, 0.3, 0.6, 0.9):
        at = plan.start + share * plan.solution.duration
        review = made.review(plan.problem, seen(plan, at, (0.01, 0.01)), at)
        assert review.plan is None
        assert not review.necessary


def test_a_state_that_left_the_plan_makes_another_necessary() -> None:
    # A long way, so that a busy machine does not decide the outcome.
    problem = Cart(start=Start(x=-1600.0))
    plan = PlanInForce(problem, problem.solve(deadline=10.0), start=10.0)
    made, delay = replanner(plan), 10.0
    made.parameters = replace(PARAMETERS, delay=delay)
    at = plan.start + 10.0
    review = made.review(problem, seen(plan, at, (-200.0, 0.0)), at)
    assert review.necessary
    assert "'x' is 200 m away from the plan in force" in review.outlook.trouble
    assert review.plan is not None, review.reason
    assert review.plan.start == pytest.approx(at + delay)
    assert review.plan.solution.verification.ok
    # It begins where the planned force will have brought the cart, not where it was.
    ahead = plan.solution.trajectory.sample(plan.elapsed(at + delay)).state
    first = review.plan.solution.trajectory.states[0]
    np.testing.assert_allclose(first, ahead + np.array([-200.0, 0.0]), atol=2.0)


def test_where_not_all_is_measured_the_deviation_is_carried_along(plan: PlanInForce) -> None:
    execution, at = GenericExecution(('x',), 0.05), plan.start + 0.4
    x = float(plan.solution.trajectory.sample(0.4).state[0])
    observed = {VEHICLE: Observation(np.array([x + 0.1]), at, Mode.FOLLOWING)}
    foreseen = execution.foresee(plan, observed, at + 0.3)
    expected = plan.solution.trajectory.sample(0.7).state[0] + 0.1
    assert foreseen[VEHICLE].state[0] == pytest.approx(expected, abs=1e-9)
    assert "'x'" in execution.outlook(plan, foreseen, at + 0.3).trouble


def test_a_cheaper_plan_takes_over_and_another_question_is_answered() -> None:
    quick = Cart(start=Start(x=-1600.0))
    rough = replace(quick, limit=0.3)
    # The plan of a weaker cart, taken for this one's: half of the time would do.
    lazy = PlanInForce(quick, rough.solve(deadline=10.0), start=0.0)
    made, at = replanner(lazy), 0.1
    made.parameters = replace(PARAMETERS, delay=10.0)
    review = made.review(quick, seen(lazy, at), at)
    assert not review.necessary
    assert review.plan is not None, review.reason
    assert 'saves' in review.reason
    asked = replace(quick, limit=2.0)
    review = made.review(asked, seen(lazy, at), at)
    assert review.necessary
    assert review.reason == 'the problem has changed'


def test_another_start_or_solver_is_not_another_question(plan: PlanInForce) -> None:
    execution = GenericExecution(('x', 'v'), 0.05)
    other = replace(
        cart(plan), start=Start(x=3.0), solver=DirectSolverParameters(deadline=1.0, seed=3)
    )
    assert execution.same_question(plan.problem, other)
    assert not execution.same_question(plan.problem, replace(cart(plan), limit=2.0))


def test_after_its_end_a_plan_is_not_in_force(plan: PlanInForce) -> None:
    made, at = replanner(plan), plan.end + 0.1
    asked = replace(cart(plan), limit=2.0)
    review = made.review(asked, seen(plan, at, (1.0, 0.0)), at)
    assert review.plan is None
    assert not review.necessary


def test_where_the_cost_to_go_is_not_known_only_necessary_plans_are_made(
    plan: PlanInForce, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cart, 'cost_to_go', lambda *_: None)
    made, at = replanner(plan), plan.start + 0.1
    review = made.review(plan.problem, seen(plan, at), at)
    assert review.plan is None
    assert review.solve_time == 0.0

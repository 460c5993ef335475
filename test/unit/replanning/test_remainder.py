# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is left of a plan, and new plans that start from it."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.pendulum_swing_up import PendulumStart
from tdm_planner.problems.switching_seeds import arcs_of
from tdm_planner.replanning import PlanInForce

SWING = build(PendulumSwingUp, {'limits.torque': 0.02})
SHARES = st.floats(0.0, 0.95)


@pytest.fixture(scope='module')
def swing() -> PlanInForce:
    return PlanInForce(SWING, SWING.solve(deadline=10.0), start=3.0)


@pytest.fixture(scope='module')
def crossing() -> PlanInForce:
    problem = RobotFormation()
    return PlanInForce(problem, problem.solve(deadline=10.0), start=-2.0)


@settings(deadline=None, max_examples=25, derandomize=True)
@given(share=SHARES)
@pytest.mark.parametrize('name', ['swing', 'crossing'])
def test_the_rest_of_a_plan_is_the_same_motion_later(
    request: pytest.FixtureRequest, name: str, share: float
) -> None:
    plan: PlanInForce = request.getfixturevalue(name)
    elapsed = share * plan.solution.duration
    rest = plan.remainder(plan.start + elapsed)
    assert rest is not None
    for vehicle, whole in plan.solution.trajectories.items():
        left = rest.trajectories[vehicle]
        if elapsed > whole.duration - 0.01:
            continue
        assert left.times[0] == 0.0
        assert left.duration == pytest.approx(whole.duration - elapsed, abs=2e-9)
        times = left.times[1:-1]
        planned, later = whole.sample(elapsed + times), left.sample(times)
        np.testing.assert_allclose(later.state, planned.state, atol=1e-6)


@settings(deadline=None, max_examples=25, derandomize=True)
@given(share=SHARES)
def test_switching_times_are_shifted_by_what_has_passed(swing: PlanInForce, share: float) -> None:
    whole = arcs_of(swing.solution.trajectory)
    rest = swing.remainder(swing.start + share * swing.solution.duration)
    assert rest is not None
    left = arcs_of(rest.trajectory)
    assert whole is not None
    assert left is not None
    count = left.signs.size
    assert list(left.signs) == list(whole.signs[-count:])
    np.testing.assert_allclose(left.durations[1:], whole.durations[-count:][1:], atol=1e-8)
    assert left.durations.sum() == pytest.approx((1 - share) * swing.solution.duration, abs=1e-6)


def test_there_is_no_rest_before_the_start_or_after_the_end(swing: PlanInForce) -> None:
    assert swing.remainder(swing.start - 0.1) is None
    assert swing.remainder(swing.end) is None
    with pytest.raises(InvalidProblem, match='nothing is left'):
        swing.solution.trajectory.after(swing.solution.duration)


@pytest.mark.parametrize('share', [0.0, 0.2, 0.5, 0.7])
def test_from_where_the_plan_leads_the_new_plan_is_its_rest(
    swing: PlanInForce, share: float
) -> None:
    elapsed = share * swing.solution.duration
    state = swing.solution.trajectory.sample(elapsed).state
    problem = replace(SWING, start=PendulumStart(*state.tolist()))
    rest = swing.remainder(swing.start + elapsed)
    new = problem.solve(deadline=10.0, warm_start=rest)
    assert new.verification.ok
    assert new.duration <= 1.002 * (swing.solution.duration - elapsed)


def test_the_evaluations_of_a_warm_start_are_few(swing: PlanInForce) -> None:
    elapsed = 0.3 * swing.solution.duration
    state = swing.solution.trajectory.sample(elapsed).state + np.array([0.01, -0.01, 0.1, 0.1])
    problem = replace(SWING, start=PendulumStart(*state.tolist()))
    warm = problem.solve(deadline=10.0, warm_start=swing.remainder(swing.start + elapsed))
    cold = problem.solve(deadline=10.0)
    assert warm.verification.ok
    assert warm.evaluations < 0.2 * cold.evaluations


@pytest.mark.parametrize('share', [0.15, 0.4, 0.6])
def test_a_smooth_torque_goes_on_without_a_jump(share: float) -> None:
    problem = build(PendulumSwingUp, {'limits.torque': 0.09, 'method': 'smooth'})
    plan = PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)
    at = share * plan.solution.duration
    now = plan.solution.trajectory.sample(at)
    torque = float(now.control[0])
    away = now.state + np.array([0.005, -0.005, 0.05, 0.05])
    asked = replace(problem, start=replace(PendulumStart(*away.tolist()), torque=torque))
    new = asked.solve(deadline=10.0, warm_start=plan.remainder(at))
    assert new.verification.ok
    first = float(new.trajectory.control('torque')[0])
    assert first == pytest.approx(torque, abs=0.03 * problem.limits.torque)

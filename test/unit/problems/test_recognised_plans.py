# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans taken for what they are from their trajectories alone: check and cost are made anew."""

from dataclasses import replace

import numpy as np
import pytest
from tdm_planner.exceptions import VerificationFailed
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.base import Problem

PATIENT = {'solver.deadline': 30.0}


@pytest.fixture(scope='module', params=[PendulumSwingUp, RobotFormation])
def planned(request):
    problem = request.param.from_parameters(PATIENT)
    return problem, problem.solve()


def test_a_plan_is_recognised_with_its_cost_and_replanned_from_alike(planned):
    problem, solution = planned
    found = problem.recognised(solution.trajectories)
    assert found.cost == solution.cost
    assert found.cost_terms == solution.cost_terms
    assert found.summary == solution.summary
    assert found.verification.worst == solution.verification.worst
    assert set(found.verifications) == set(solution.verifications)
    again = [problem.solve(warm_start=plan) for plan in (solution, found)]
    assert again[1].evaluations == again[0].evaluations
    assert again[1].cost == pytest.approx(again[0].cost, rel=1e-9)
    if isinstance(problem, PendulumSwingUp):  # the arcs are found again
        np.testing.assert_allclose(found.parameters, solution.parameters, atol=1e-8)
        largest = np.abs(solution.trajectory.controls).max()
        weaker = PendulumSwingUp.from_parameters({'limits.torque': 0.9 * float(largest)})
        with pytest.raises(VerificationFailed, match='torque'):
            weaker.recognised(solution.trajectories)


def test_a_recognised_plan_that_does_nothing_has_no_arcs():
    problem = PendulumSwingUp.from_parameters({'start.theta': 0.0})
    found = problem.recognised(problem.solve().trajectories)
    assert not found.parameters.size
    moved = PendulumSwingUp.from_parameters({'start.theta': 0.3, **PATIENT})
    assert moved.solve(warm_start=found).verification.ok


def test_what_does_not_reach_the_goal_is_not_recognised(planned):
    problem, solution = planned
    spoilt = {
        name: replace(motion, controls=0.9 * motion.controls)
        for name, motion in solution.trajectories.items()
    }
    with pytest.raises(VerificationFailed):
        problem.recognised(spoilt)


def test_a_problem_that_cannot_assess_plans_says_so(planned):
    class Silent(type(planned[0])):
        assess = Problem.assess

    with pytest.raises(VerificationFailed, match='cannot assess'):
        Silent.from_parameters({}).recognised(planned[1].trajectories)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Robots late on their way keep what their plan has left, and the others plan round them."""

from dataclasses import replace

import numpy as np
import pytest
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.kept_motion import kept_motions, LATE, turning_time
from tdm_planner.replanning import FormationExecution, Mode, Observation, PlanInForce

AWAY = np.array([0.008, -0.008, 0.005, 0.005, 0.01, 0.01, 0.0])


@pytest.fixture(scope='module')
def crossing() -> PlanInForce:
    problem = RobotFormation()
    return PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)


def late(plan: PlanInForce) -> float:
    """Return an instant at which the first robot is on its last leg."""
    rate = plan.problem.limits.thruster_rate
    return plan.solution.trajectories['robot1'].duration - 0.8 * turning_time(rate)


def asked_at(plan: PlanInForce, at: float, asked=None, **away: np.ndarray) -> RobotFormation:
    """Return the problem `asked`, or that of the plan, from where the robots are seen then."""
    seen = {
        name: Observation(motion.sample(at).state + away.get(name, 0.0), at, Mode.FOLLOWING)
        for name, motion in plan.solution.trajectories.items()
    }
    execution = FormationExecution(plan.problem)
    return execution.problem_from(asked or plan.problem, execution.foresee(plan, seen, at))


def test_a_robot_about_to_arrive_keeps_its_motion(crossing: PlanInForce) -> None:
    at = late(crossing)
    problem = asked_at(crossing, at, robot1=AWAY, robot3=2 * AWAY)
    new = problem.solve(deadline=10.0, warm_start=crossing.remainder(at))
    assert new.verification.ok
    old = crossing.solution.trajectories['robot1']
    kept = new.trajectories['robot1']
    assert kept.duration == pytest.approx(old.duration - at, abs=1e-6)
    times = np.linspace(0.0, kept.duration, 200)
    controls = kept.controls_at(times), old.controls_at(times + at)
    np.testing.assert_allclose(*controls, atol=1e-6)
    states = kept.sample(times).state, old.sample(times + at).state
    np.testing.assert_allclose(*states, atol=1e-3)
    # Another robot's deviation, with more time left, is planned from.
    away = np.abs(new.trajectories['robot3'].states[0, :2] - problem.task.start[2]).max()
    assert away < 1e-9


@pytest.mark.parametrize('push', [0.0, 0.1])
def test_a_robot_that_was_pushed_is_planned_from_where_it_is(crossing, push) -> None:
    at = late(crossing)
    problem = asked_at(crossing, at, robot1=AWAY + push * np.eye(7)[2])
    planned = crossing.solution.trajectories['robot1'].sample(at).state[:2]
    expected = planned + AWAY[:2] if push else planned
    np.testing.assert_allclose(problem.task.start[0], expected, atol=1e-9)
    kept = kept_motions(problem.task, crossing.remainder(at).trajectories, LATE)
    assert ('robot1' in kept) == (not push)


def test_no_motion_is_kept_that_leads_elsewhere(crossing) -> None:
    at, formation = late(crossing), crossing.problem.formation
    x, y, turn = formation.anchor
    moved = replace(crossing.problem, formation=replace(formation, anchor=[x + 0.1, y, turn]))
    planned = crossing.solution.trajectories['robot1'].sample(at).state[:2]
    problem = asked_at(crossing, at, moved, robot1=AWAY)
    np.testing.assert_allclose(problem.task.start[0], planned + AWAY[:2], atol=1e-9)
    exact = asked_at(crossing, at, moved)
    assert kept_motions(exact.task, crossing.remainder(at).trajectories, LATE) == {}

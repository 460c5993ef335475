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
import itertools

import numpy as np
import pytest
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation_program import FormationProgram
from tdm_planner.problems.kept_motion import kept_motions, LATE, turning_time
from tdm_planner.problems.reference_motion import ReferenceMotion
from tdm_planner.replanning import FormationExecution, Mode, Observation, PlanInForce

AWAY = np.array([0.008, -0.008, 0.005, 0.005, 0.01, 0.01, 0.0])


@pytest.fixture(scope='module')
def crossing() -> PlanInForce:
    problem = RobotFormation()
    return PlanInForce(problem, problem.solve(deadline=10.0), start=0.0)


def problem_of(plan: PlanInForce) -> RobotFormation:
    assert isinstance(plan.problem, RobotFormation)
    return plan.problem


def late(plan: PlanInForce) -> float:
    """Return an instant at which the first robot is on its last leg."""
    rate = problem_of(plan).limits.thruster_rate
    return plan.solution.trajectories['robot1'].duration - 0.8 * turning_time(rate)


def seen_at(plan: PlanInForce, at: float, away: dict[str, np.ndarray]) -> dict[str, Observation]:
    return {
        name: Observation(motion.sample(at).state + away.get(name, 0.0), at, Mode.FOLLOWING)
        for name, motion in plan.solution.trajectories.items()
    }


def asked_at(plan: PlanInForce, at: float, away: dict[str, np.ndarray]) -> RobotFormation:
    execution = FormationExecution(problem_of(plan))
    return execution.problem_from(
        problem_of(plan), execution.foresee(plan, seen_at(plan, at, away), at)
    )


def test_a_robot_about_to_arrive_keeps_its_motion(crossing: PlanInForce) -> None:
    at = late(crossing)
    problem = asked_at(crossing, at, {'robot1': AWAY, 'robot3': 2 * AWAY})
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
def test_a_robot_that_was_pushed_is_planned_from_where_it_is(
    crossing: PlanInForce, push: float
) -> None:
    at = late(crossing)
    pushed = np.array([0.0, 0.0, push, 0.0, 0.0, 0.0, 0.0])
    problem = asked_at(crossing, at, {'robot1': pushed + AWAY})
    planned = crossing.solution.trajectories['robot1'].sample(at).state
    rest = crossing.remainder(at)
    assert rest is not None
    kept = kept_motions(problem.task, rest.trajectories, LATE)
    if push:
        np.testing.assert_allclose(problem.task.start[0], planned[:2] + AWAY[:2], atol=1e-9)
        assert 'robot1' not in kept
    else:
        np.testing.assert_allclose(problem.task.start[0], planned[:2], atol=1e-9)
        assert 'robot1' in kept


def test_no_motion_is_kept_that_leads_elsewhere(crossing: PlanInForce) -> None:
    at = late(crossing)
    rest = crossing.remainder(at)
    assert rest is not None
    x, y, turn = problem_of(crossing).formation.anchor
    moved = replace(
        problem_of(crossing),
        formation=replace(problem_of(crossing).formation, anchor=[x + 0.1, y, turn]),
    )
    execution = FormationExecution(problem_of(crossing))
    foreseen = execution.foresee(crossing, seen_at(crossing, at, {'robot1': AWAY}), at)
    problem = execution.problem_from(moved, foreseen)
    np.testing.assert_allclose(problem.task.start[0], foreseen['robot1'].state[:2], atol=1e-9)
    exact = execution.problem_from(
        moved, execution.foresee(crossing, seen_at(crossing, at, {}), at)
    )
    assert kept_motions(exact.task, rest.trajectories, LATE) == {}


def test_held_motions_are_avoided_and_not_varied() -> None:
    task = RobotFormation().task
    model = ReferenceMotion(task)
    every = FormationProgram(model)
    guess = np.random.default_rng(3).normal(scale=0.05, size=(task.n, model.size))
    guess[:, 0] = 1.0
    held = np.full_like(guess, np.nan)
    held[1] = guess[1]
    program = FormationProgram(model, held=held)
    xi = program.reduce(guess)
    assert xi.size == every.reduce(guess).size - model.size
    np.testing.assert_array_equal(program.full(xi)[1], guess[1])
    np.testing.assert_allclose(program.full(xi), guess)
    with_it, without = program.values(xi), every.values(guess.ravel())
    np.testing.assert_allclose(with_it.gas, without.gas)
    np.testing.assert_allclose(with_it.pairs.margins, without.pairs.margins)
    assert (with_it.thrust[1] > 1.0).all()
    np.testing.assert_array_equal(with_it.thrust[[0, 2]], without.thrust[[0, 2]])
    rows = program.linearise(program.evaluate(xi), None).inequality_jacobian
    assert rows.shape[1] == xi.size


def test_two_robots_about_to_arrive_leave_the_third_all_the_room_there_is() -> None:
    task = RobotFormation().task
    model = ReferenceMotion(task)
    guess = np.zeros((task.n, model.size))
    guess[:, 0] = 1.0
    for kept in itertools.combinations(range(task.n), 2):
        held = np.full_like(guess, np.nan)
        held[list(kept)] = guess[list(kept)]
        program = FormationProgram(model, held=held)
        values = program.values(program.reduce(guess))
        first, second = program.grid.pairs.robots(values.pairs)
        between = np.isin(first, kept) & np.isin(second, kept)
        assert (values.pairs.margins[between] > 1.0).all()

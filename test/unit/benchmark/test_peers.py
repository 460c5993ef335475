# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The peers solve the same problems, and what counts as solved is."""

from __future__ import annotations

from dataclasses import replace

from benchmark.peers.attempts import against, Attempt, best_of, summary
from benchmark.peers.judge import formation_cost, judge_formation, judge_pendulum
from benchmark.peers.pendulum_guesses import energy_swing, HARD, straight_line
from benchmark.pendulum import problem, start_state
from benchmark.scenarios import crossing
import numpy as np
import pytest
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.base import Solution

RNG_STATES = 20
SEED = 1


@pytest.fixture(scope='module')
def swing() -> Solution:
    return problem(0.09, start_state(SEED)).solve(5.0)


@pytest.fixture(scope='module')
def formation() -> tuple[RobotFormation, Solution]:
    stated = RobotFormation.from_parameters(crossing(0).parameters())
    return stated, stated.solve(20.0)


def test_the_dynamics_of_the_pendulum_are_the_plants():
    pytest.importorskip('casadi')
    from benchmark.peers.pendulum_collocation import dynamics

    task = problem(0.02, start_state(SEED)).task
    w0 = task.plant.natural_frequency
    f = dynamics(task.plant, task.torque)
    rng = np.random.default_rng(1)
    for x, u in zip(rng.normal(size=(RNG_STATES, 4)), rng.normal(size=RNG_STATES), strict=True):
        unit = np.array([1.0, 1.0, w0, w0])
        expected = task.plant.derivative(x * unit, np.array([u * task.torque])) / (unit * w0)
        np.testing.assert_allclose(np.asarray(f(x, u)).ravel(), expected, rtol=1e-10, atol=1e-12)


def test_the_dynamics_of_the_robots_are_the_plants():
    pytest.importorskip('casadi')
    from benchmark.peers import robots_collocation as peer

    task = RobotFormation.from_parameters(crossing(0).parameters()).task
    limits = np.array([0.3, 0.5, 0.002])
    f = peer.dynamics(task.plant, limits)
    rng = np.random.default_rng(1)
    for x, u in zip(
        rng.normal(size=(RNG_STATES, 7)), rng.normal(size=(RNG_STATES, 3)), strict=True
    ):
        expected = task.plant.derivative(x * peer.STATE_UNITS, u * limits)
        expected = expected * peer.TIME_UNIT / peer.STATE_UNITS
        np.testing.assert_allclose(np.asarray(f(x, u)).ravel(), expected, rtol=1e-10, atol=1e-12)


def test_the_dynamics_that_drake_derives_from_bodies_are_the_plants():
    pytest.importorskip('pydrake')
    from benchmark.peers.drake_pendulum import multibody

    plant = problem(0.02, start_state(SEED)).plant
    model = multibody(plant, 0.02, 10.0)
    context = model.CreateDefaultContext()
    rng = np.random.default_rng(1)
    for x, u in zip(rng.normal(size=(RNG_STATES, 4)), rng.normal(size=RNG_STATES), strict=True):
        model.SetPositionsAndVelocities(context, x[[1, 0, 3, 2]])
        model.get_actuation_input_port().FixValue(context, [u])
        found = model.EvalTimeDerivatives(context).CopyToVector()[[1, 0, 3, 2]]
        unit = np.array([1.0, 1.0, 10.0, 10.0])
        expected = plant.derivative(x * unit, np.array([0.02 * u])) / (10.0 * unit)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_collocation_finds_the_time_this_package_finds(swing: Solution):
    pytest.importorskip('casadi')
    from benchmark.peers.pendulum_collocation import PendulumCollocation

    task = problem(0.09, start_state(SEED)).task
    guess = energy_swing(task, HARD)
    collocation = PendulumCollocation(task, 50)
    found = collocation.solve(task.start, task.goal_nearest(guess.states[-1]), guess)
    motion = collocation.trajectory(found)
    assert found.converged
    assert judge_pendulum(task, motion) == ()
    assert motion.duration == pytest.approx(swing.cost, rel=0.03)


def test_collocation_of_the_robots_lands_within_the_limits():
    pytest.importorskip('casadi')
    from benchmark.peers.robots_collocation import FormationCollocation

    task = RobotFormation.from_parameters(crossing(1, 2).parameters()).task
    collocation = FormationCollocation(task, 20, 3, tol=1e-6, acceptable_tol=1e-4)
    found = collocation.solve(task, collocation.guess_ways(task, 0.15))
    motions = collocation.trajectories(task, found)
    assert found.converged
    assert judge_formation(task, motions) == ()


def test_ruckigs_bound_is_below_every_plan(formation: tuple[RobotFormation, Solution]):
    pytest.importorskip('ruckig')
    from benchmark.peers.ruckig_bound import bound

    stated, plan = formation
    found = bound(stated.task)
    assert 0.5 * plan.cost < found.cost < plan.cost
    assert found.separation < stated.task.separation  # the crossings are drawn to collide


def test_the_judge_accepts_a_plan_and_rejects_what_misses_or_breaks_a_limit(swing: Solution):
    task, motion = problem(0.09, start_state(SEED)).task, swing.trajectory
    assert judge_pendulum(task, motion) == ()
    weaker = replace(motion, controls=0.9 * motion.controls)
    assert any('ends' in reason for reason in judge_pendulum(task, weaker))
    assert any(
        'torque' in reason for reason in judge_pendulum(replace(task, torque_limit=0.08), motion)
    )
    narrow = replace(task, disk_angle=0.5 * float(np.abs(motion.state('psi')).max()))
    assert any('disk_angle' in reason for reason in judge_pendulum(narrow, motion))


def test_the_judge_takes_nothing_but_the_controls(swing: Solution):
    task, motion = problem(0.09, start_state(SEED)).task, swing.trajectory
    states = motion.states.copy()
    states[1:-1] = 7.0
    assert judge_pendulum(task, replace(motion, states=states)) == ()


def test_the_judge_of_formations_rejects_collisions_and_misses(
    formation: tuple[RobotFormation, Solution],
):
    stated, plan = formation
    task, motions = stated.task, plan.trajectories
    assert judge_formation(task, motions) == ()
    assert formation_cost(task, motions) == pytest.approx(plan.cost, rel=1e-3)
    wide = replace(task, separation=1.5 * task.separation)
    assert any('separation' in reason for reason in judge_formation(wide, motions))
    first = task.names[0]
    pushed = replace(motions[first], controls=0.9 * motions[first].controls)
    assert any('ends' in reason for reason in judge_formation(task, {**motions, first: pushed}))


def test_guesses_start_at_the_start():
    task = problem(0.02, start_state(3)).task
    for guess in (straight_line(task), energy_swing(task, HARD)):
        np.testing.assert_allclose(guess.states[0], task.start)
        assert guess.duration > 0


def attempt(case: int, solved: bool, seconds: float, cost: float) -> Attempt:
    return Attempt(case, True, solved, seconds, 10, cost)


def test_the_best_of_several_guesses_costs_the_time_of_all():
    best = best_of(
        [attempt(0, True, 1.0, 3.0), attempt(0, False, 2.0, 1.0), attempt(0, True, 3.0, 2.0)]
    )
    assert (best.solved, best.seconds, best.cost, best.iterations) == (True, 6.0, 2.0, 30)
    none = best_of([attempt(0, False, 1.0, 3.0), attempt(0, False, 2.0, 1.0)])
    assert not none.solved
    assert none.cost is None


def test_summary_counts_unsolved_cases_as_failures():
    attempts = [
        attempt(0, True, 1.0, 1.0),
        attempt(1, False, 3.0, 1.0),
        attempt(2, True, 2.0, 1.5),
    ]
    found = summary([a.to_dict() for a in attempts], {0: 1.0, 1: 1.0, 2: 1.0})
    assert found['solved'] == pytest.approx(2 / 3)
    assert found['near'] == pytest.approx(1 / 3)
    assert found['ratio_median'] == pytest.approx(1.25)
    assert found['ms_median'] == pytest.approx(2000.0)


def test_relative_figures_compare_the_same_cases():
    ours = [attempt(0, True, 1.0, 1.0), attempt(1, True, 2.0, 2.0)]
    theirs = [attempt(1, True, 8.0, 3.0)]
    found = against([a.to_dict() for a in ours], [a.to_dict() for a in theirs])
    assert found == {'time': pytest.approx(4.0), 'cost': pytest.approx(1.5)}

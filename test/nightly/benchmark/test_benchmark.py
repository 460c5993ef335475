# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmark runs for real, and the peers solve the same problems as this package."""

from benchmark import runner
from benchmark.peers.pendulum import energy_swing, HARD, PendulumCases, PendulumCollocation
from benchmark.peers.robots import FormationCollocation, RobotsCases
from benchmark.pendulum import problem, start_state
from benchmark.replanning import pendulum
from benchmark.scenarios import crossing
from benchmark.sections import SECTIONS
import pytest
from tdm_planner.problems import RobotFormation


def test_collocation_finds_the_time_this_package_finds():
    task = problem(0.09, start_state(1)).task
    guess = energy_swing(task, HARD)
    collocation = PendulumCollocation(task, 50)
    found = collocation.solve(task, guess)
    reasons, duration = PendulumCases.judge(task, collocation.motions(task, found))
    assert found.converged
    assert reasons == ()
    cost = problem(0.09, start_state(1)).solve(5.0).cost
    assert duration == pytest.approx(cost, rel=0.03)


def test_collocation_of_the_robots_lands_within_the_limits():
    task = RobotFormation.from_parameters(crossing(1, 2).parameters()).task
    collocation = FormationCollocation(task, 20, 3, tol=1e-6, acceptable_tol=1e-4)
    found = collocation.solve(task, collocation.guess_ways(task, 0.15))
    motions = collocation.motions(task, found)
    assert found.converged
    assert RobotsCases.judge(task, motions)[0] == ()


def test_sections_for_real():
    settings = {'scenarios': 1, 'teams': False, 'variants': False}
    outcome = runner.run(SECTIONS['robots'], settings, lambda _: None)
    assert not outcome.failure
    assert outcome.figures['3 robots']['verified'] == 1
    assert '1/1' in SECTIONS['robots'].table(outcome.figures)
    assert pendulum(0.3, seeds=1)['runs'] == 1

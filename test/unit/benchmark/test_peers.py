# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the benchmark compares with: the peers' models, what counts as solved, a search by hand."""

from __future__ import annotations

from dataclasses import replace

from benchmark.peers.attempts import against, Attempt, best_of, summary
from benchmark.peers.judge import formation_cost, judge_formation, judge_pendulum
from benchmark.pendulum import problem, start_state
from benchmark.scenarios import crossing
import numpy as np
import pytest
from tdm_planner.problems import RobotFormation


def test_the_dynamics_of_the_peers_are_the_plants() -> None:
    pytest.importorskip('casadi')
    from benchmark.peers import pendulum_collocation, robots_collocation

    rng = np.random.default_rng(1)
    task = problem(0.02, start_state(1)).task
    w0 = task.plant.natural_frequency
    unit = np.array([1.0, 1.0, w0, w0])
    f = pendulum_collocation.dynamics(task.plant, task.torque)
    for x, u in zip(rng.normal(size=(20, 4)), rng.normal(size=20), strict=True):
        expected = task.plant.derivative(x * unit, np.array([u * task.torque])) / (unit * w0)
        np.testing.assert_allclose(np.asarray(f(x, u)).ravel(), expected, rtol=1e-10, atol=1e-12)
    robot = RobotFormation.from_parameters(crossing(0).parameters()).task.plant
    limits, unit = np.array([0.3, 0.5, 0.002]), robots_collocation.STATE_UNITS
    f = robots_collocation.dynamics(robot, limits)
    for x, u in zip(rng.normal(size=(20, 7)), rng.normal(size=(20, 3)), strict=True):
        expected = robot.derivative(x * unit, u * limits) * robots_collocation.TIME_UNIT / unit
        np.testing.assert_allclose(np.asarray(f(x, u)).ravel(), expected, rtol=1e-10, atol=1e-12)


def test_the_judge_of_swing_ups_takes_nothing_but_the_controls() -> None:
    made = problem(0.09, start_state(1))
    task, motion = made.task, made.solve(5.0).trajectory
    assert judge_pendulum(task, motion) == ()
    states = motion.states.copy()
    states[1:-1] = 7.0
    assert judge_pendulum(task, replace(motion, states=states)) == ()
    narrow = 0.5 * float(np.abs(motion.state('psi')).max())
    for judged, plan, reason in (
        (task, replace(motion, controls=0.9 * motion.controls), 'ends'),
        (replace(task, torque_limit=0.08), motion, 'torque'),
        (replace(task, disk_angle=narrow), motion, 'disk_angle'),
    ):
        assert any(reason in said for said in judge_pendulum(judged, plan))


def test_the_judge_of_formations_rejects_collisions_and_misses() -> None:
    stated = RobotFormation.from_parameters(crossing(0).parameters())
    plan = stated.solve(20.0)
    task, motions = stated.task, plan.trajectories
    assert judge_formation(task, motions) == ()
    assert formation_cost(task, motions) == pytest.approx(plan.cost, rel=1e-3)
    wide = replace(task, separation=1.5 * task.separation)
    assert any('separation' in reason for reason in judge_formation(wide, motions))
    first = task.names[0]
    pushed = replace(motions[first], controls=0.9 * motions[first].controls)
    assert any('ends' in reason for reason in judge_formation(task, {**motions, first: pushed}))


def attempt(case: int, solved: bool, seconds: float, cost: float) -> Attempt:
    return Attempt(case, True, solved, seconds, 10, cost)


def test_figures_of_attempts() -> None:
    """The best of several guesses costs the time of all; what is unsolved counts as a failure."""
    tries = [attempt(0, True, 1.0, 3.0), attempt(0, False, 2.0, 1.0), attempt(0, True, 3.0, 2.0)]
    best = best_of(tries)
    assert (best.solved, best.seconds, best.cost, best.iterations) == (True, 6.0, 2.0, 30)
    assert (best_of(tries[1:2]).solved, best_of(tries[1:2]).cost) == (False, None)
    several = [attempt(0, True, 1.0, 1.0), attempt(1, False, 3.0, 1.0), attempt(2, True, 2.0, 1.5)]
    found = summary([a.to_dict() for a in several], {0: 1.0, 1: 1.0, 2: 1.0})
    figures = [found[name] for name in ('solved', 'near', 'ratio_median', 'ms_median')]
    assert figures == pytest.approx([2 / 3, 1 / 3, 1.25, 2000.0])
    # relative figures compare the same cases
    ours = [attempt(0, True, 1.0, 1.0).to_dict(), attempt(1, True, 2.0, 2.0).to_dict()]
    theirs = [attempt(1, True, 8.0, 3.0).to_dict()]
    assert against(ours, theirs) == {'time': pytest.approx(4.0), 'cost': pytest.approx(1.5)}

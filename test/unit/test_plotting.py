# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pictures of plans: everything is in them, and drawn where it is."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from tdm_planner import plotting
from tdm_planner.direct_method import Duration, Output
from tdm_planner.formation_plot import FormationView, plot_formation
from tdm_planner.palette import LIMIT, SWITCH
from tdm_planner.parameters import group, Validated
from tdm_planner.plan_margins import plan_margins
from tdm_planner.plotting import plot_limits, plot_solution, plot_trajectory
from tdm_planner.problems import (
    DirectProblem,
    PendulumSwingUp,
    Problem,
    RobotFormation,
    SolverParameters,
)
from tdm_planner.verification import Constraint


class Foreign(Problem):
    """Neither derived from the built-in ones nor stated as a formulation; without limits."""

    name = 'foreign'

    def search(self, budget, rng, previous):
        raise NotImplementedError


@pytest.fixture(scope='module')
def swing_up():
    problem = PendulumSwingUp.from_parameters({})
    return problem, problem.solve(deadline=5.0)


@pytest.fixture(scope='module')
def formation():
    problem = RobotFormation.from_parameters({})
    return problem, problem.solve(deadline=5.0)


def titles(figure):
    return [axis.get_ylabel() for axis in figure.axes]


def levels(axis, colour):
    """Where lines of a colour lie."""
    return [
        (line.get_xdata()[0], line.get_ydata()[0])
        for line in axis.get_lines()
        if line.get_color() == colour
    ]


def test_margins_are_those_of_the_check(swing_up, formation):
    for problem, solution in (swing_up, formation):
        checks = solution.verifications or {
            name: solution.verification for name in solution.trajectories
        }
        for name, trajectory in solution.trajectories.items():
            for margin in plan_margins(problem, trajectory):
                worst = checks[name].worst[margin.name]
                assert margin.values.min() == pytest.approx(worst, abs=2e-3), margin.name


def test_margins_of_a_problem_with_a_search_of_its_own(swing_up):
    class Limited(Foreign):
        """With one."""

        def constraints_on(self, trajectory):
            fastest = np.abs(trajectory.state('theta_dot')).max()
            return (
                Constraint('rate', lambda t, x, u: 2 * fastest - np.abs(x[:, 2]), unit='rad/s'),
            )

    plan = swing_up[1].trajectory
    assert plan_margins(Foreign(), plan) == ()
    (margin,) = plan_margins(Limited(), plan)
    assert (margin.name, margin.unit) == ('rate', 'rad/s')
    fastest = np.abs(plan.state('theta_dot')).max()
    assert margin.values.max() == pytest.approx(2 * fastest, rel=1e-2)
    assert margin.values.min() == pytest.approx(fastest, rel=1e-2)


def test_upright_is_marked_for_the_pendulum_alone(swing_up, tmp_path, monkeypatch):
    drawn = []

    def draw(*arguments, **options):
        drawn.append(plot_trajectory(*arguments, **options))
        return drawn[-1]

    monkeypatch.setattr(plotting, 'plot_trajectory', draw)

    def marked(problem, solution):
        plot_solution(problem, solution, tmp_path / 'plan.svg')
        return {
            axis.get_ylabel(): text.xy[1]
            for axis in drawn[-1].axes
            for text in axis.texts
            if text.get_text() == 'upright'
        }

    problem, solution = swing_up
    end = solution.trajectory.state('theta')[-1]
    assert marked(problem, solution) == {'theta [rad]': pytest.approx(end, abs=1e-3)}
    names = ('x', 'theta', 'v', 'theta_dot')  # of another plant
    foreign = replace(solution.trajectory, state_names=names)
    other = replace(solution, trajectories={'cart': foreign})
    assert marked(Foreign(), other) == {}


def test_margins_of_a_stated_problem_are_what_it_states() -> None:
    @dataclass(frozen=True)
    class Cart(DirectProblem, Validated):
        name: ClassVar[str] = 'cart'
        state_names, state_units = ('x', 'v'), ('m', 'm/s')
        control_names, control_units = ('u',), ('m/s^2',)
        solver: SolverParameters = group(SolverParameters)

        def outputs(self):
            return {'x': Output((1.0, 0.0), (0.0, 0.0), free=1)}

        def duration(self):
            return Duration(2.0, fixed=True)

        def invert(self, y, z):
            return y['x'][:2], y['x'][2:]

        def derivative(self, x, u):
            return x[1], u[0]

        def margins(self, t, x, u):
            return {'push': 2.0 - u[0], 'pull': 2.0 + u[0]}

        def running_cost(self, t, x, u):
            return u[0] ** 2

    problem = Cart()
    solution = problem.solve(deadline=10.0)
    margins = {m.name: m.values for m in plan_margins(problem, solution.trajectory)}
    assert list(margins) == ['push', 'pull']
    np.testing.assert_allclose(margins['push'] + margins['pull'], 4.0)
    for name, values in margins.items():
        assert values.min() == pytest.approx(solution.verification.worst[name], abs=1e-3)


def test_a_swing_up_has_every_quantity_with_limits_and_switches(swing_up):
    problem, solution = swing_up
    margins = plan_margins(problem, solution.trajectory)
    figure = plot_trajectory(solution.trajectory, plot_limits(problem), margins=margins)
    assert titles(figure) == [
        'theta [rad]',
        'psi [rad]',
        'theta_dot [rad/s]',
        'psi_dot [rad/s]',
        'torque [N m]',
        'margin of\ntorque [N m]',
        'margin of\ndisk_angle [rad]',
    ]
    by_title = dict(zip(titles(figure), figure.axes, strict=True))
    assert sorted(y for _, y in levels(by_title['torque [N m]'], LIMIT)) == [-0.02, 0.02]
    assert sorted(y for _, y in levels(by_title['psi [rad]'], LIMIT)) == [-2.0, 2.0]
    torque = solution.trajectory.control('torque')
    jumps = solution.trajectory.times[1:-1][np.diff(torque[:-1]) != 0]
    assert jumps.size
    for axis in figure.axes:
        assert [x for x, _ in levels(axis, SWITCH)] == pytest.approx(jumps.tolist())


def test_a_formation_has_every_quantity_of_every_robot(formation):
    problem, solution = formation
    margins = {n: plan_margins(problem, t) for n, t in solution.trajectories.items()}
    figure = plot_formation(FormationView.of(problem), solution.trajectories, margins=margins)
    plan = next(iter(solution.trajectories.values()))
    shown = titles(figure)
    for name in (*plan.state_names, *plan.control_names):
        assert any(title.startswith(f'{name} [') for title in shown), name
    for name in ('thrust', 'thruster_rate', 'torque', 'walls'):
        assert any(title.startswith(f'margin of\n{name} [') for title in shown), name
    thrust = next(a for a in figure.axes if a.get_ylabel() == 'thrust [N]')
    assert len(thrust.get_lines()) == len(solution.trajectories) + 2
    assert [y for _, y in levels(thrust, LIMIT)] == [0.0, problem.limits.thrust]
    x = next(a for a in figure.axes[2:] if a.get_ylabel() == 'x [m]')
    half = problem.arena.minimum_separation / 2
    assert [y for _, y in levels(x, LIMIT)] == [half, problem.arena.length - half]


@pytest.mark.parametrize(
    ('ending', 'start'), [('.png', b'\x89PNG'), ('.pdf', b'%PDF'), ('.svg', b'<?xml')]
)
def test_kinds_of_files(swing_up, tmp_path, ending, start):
    problem, solution = swing_up
    path = tmp_path / f'plan{ending}'
    plot_solution(problem, solution, path)
    assert path.read_bytes().startswith(start)


def test_a_formation_as_a_file(formation, tmp_path):
    problem, solution = formation
    plot_solution(problem, solution, tmp_path / 'plan.svg')
    assert (tmp_path / 'plan.svg').stat().st_size > 50_000

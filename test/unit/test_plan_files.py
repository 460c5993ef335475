# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans as files, of which every bit is kept, and as pictures, in which everything is drawn."""

from collections.abc import Mapping
import csv
from dataclasses import dataclass, replace
import itertools
import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

from double_integrator import DoubleIntegrator
import numpy as np
import pytest
from stated import changed
from tdm_planner.drawing import LIMIT, SWITCH
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plan_files import check_path, load_plan, save_plan, UnusableFile
from tdm_planner.problems import PendulumSwingUp, Problem, RobotFormation
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint
from tdm_sim.report.mission import Mission
from tdm_sim.report.plotting import plot_plan, plot_solution
from tdm_sim.report.recorded_vehicles import planned_vehicles
from tdm_sim.report.signals import Signals

CART = DoubleIntegrator()  # stated as a formulation, with margins of its own
# Neither derived from the built-in ones nor stated as a formulation; without limits.
Foreign = dataclass(changed(Problem, name='foreign', search=Mock(side_effect=NotImplementedError)))


@pytest.fixture(scope='module')
def swing_up() -> Any:
    return PendulumSwingUp(), PendulumSwingUp().solve(deadline=5.0)


@pytest.fixture(scope='module')
def formation() -> Any:
    return RobotFormation(), RobotFormation().solve(deadline=5.0)


def test_json_csv_and_npz_keep_every_bit(swing_up: Any, tmp_path: Path) -> None:
    solution = swing_up[1]
    original = solution.trajectory
    for ending in ('json', 'csv', 'npz'):
        save_plan(solution.to_dict(), f'{tmp_path}/plan.{ending}')
    plan = load_plan(f'{tmp_path}/plan.json')
    again = Trajectory.from_dict(plan)
    for name in ('times', 'states', 'controls', 'rates'):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    assert plan['interpolation'] == 'zero_order_hold'
    assert plan['verification']['worst'] == solution.verification.worst
    assert set(plan) >= {'problem', 'duration', 'cost', 'penalty', 'solve_time', 'evaluations'}
    head, *rows = csv.reader((tmp_path / 'plan.csv').open())
    assert head == ['time', *original.state_names, 'torque']
    np.testing.assert_array_equal(np.array(rows, dtype=float)[:, 1:5], original.states)
    with np.load(tmp_path / 'plan.npz') as arrays:
        np.testing.assert_array_equal(arrays['times'], original.times)
        np.testing.assert_array_equal(arrays['theta'], original.states[:, 0])


def test_several_vehicles(formation: Any, tmp_path: Path) -> None:
    solution = formation[1]
    plan, robots = solution.to_dict(), solution.trajectories
    assert set(plan['robots']) == set(robots)
    save_plan(plan, tmp_path / 'plan.csv')
    rows = list(csv.reader((tmp_path / 'plan.csv').open()))
    places = [name for name, planned in robots.items() for _ in planned.times]
    assert [row[0] for row in rows] == ['robot', *places]
    save_plan(plan, tmp_path / 'plan.json')
    assert load_plan(tmp_path / 'plan.json')['robots'] == plan['robots']
    assert solution.trajectory.state_names[:2] == ('robot1.x', 'robot1.y')


def test_what_cannot_be_written_or_is_no_plan_is_refused(tmp_path: Path) -> None:
    for name in ('plan.txt', 'plan', 'missing/plan.json', ''):
        with pytest.raises(InvalidProblem):
            check_path(tmp_path / name)
    path = tmp_path / 'plan.json'
    with pytest.raises(InvalidProblem, match='cannot be read'):
        load_plan(path)
    document = {'problem': 'x', 'times': [0.0, 0.0], 'interpolation': 'linear'}
    path.write_text(json.dumps({**document, 'states': {'x': [0, 1]}, 'controls': {'u': [0, 0]}}))
    with pytest.raises(UnusableFile, match=f"'{path}' is not a plan written by tdm: .*times"):
        load_plan(path)


@pytest.mark.parametrize('name', ['cost', 'times', 'interpolation', 'position'])
def test_names_that_a_format_has_otherwise_are_refused_there(name: str, tmp_path: Path) -> None:
    """The array of a state was overwritten by a figure of the plan."""
    plan = {'problem': 'x', 'duration': 1.0, 'cost': 2.0, 'penalty': 0.0, 'solve_time': 0.1}
    plan |= {'evaluations': 3, 'times': [0.0, 1.0], 'interpolation': 'linear'}
    plan |= {'states': {'position': [0.0, 1.0]}, 'controls': {name: [1.0, 1.0]}}
    with pytest.raises(UnusableFile, match=f"cannot hold the control '{name}'"):
        save_plan(plan, tmp_path / 'plan.npz')
    assert not list(tmp_path.iterdir())


def levels(axis: Any, colour: str, way: str = 'y') -> list[float]:
    lines = [line for line in axis.get_lines() if line.get_color() == colour]
    return [getattr(line, f'get_{way}data')()[0] for line in lines]


def histories_of(problem: Problem, plans: Mapping[str, Trajectory]) -> list[Signals]:
    return [vehicle.margins.planned for vehicle in planned_vehicles(problem, plans)]


def test_margins_are_those_of_the_check(swing_up, formation, monkeypatch):
    for problem, solution in (swing_up, formation, (CART, CART.solve(deadline=10.0))):
        checks = solution.verifications.values() or [solution.verification]
        found = histories_of(problem, solution.trajectories)
        for check, history in zip(checks, found, strict=True):
            margins = history.columns
            assert margins
            for name, values in margins.items():
                assert np.isnan(values[-1])  # the gap behind a plan
                if (problem.name, name) != ('robot_formation', 'thrust'):  # of one side only
                    assert values[:-1].min() == pytest.approx(check.worst[name], abs=2e-3), name
    assert list(margins) == ['push', 'pull']
    np.testing.assert_allclose((margins['push'] + margins['pull'])[:-1], 2.0)
    plans = swing_up[1].trajectories
    assert not any(histories_of(Foreign(), plans))
    limited, fastest = Foreign(), np.abs(swing_up[1].trajectory.state('theta_dot')).max()
    rate = Constraint('rate', lambda t, x, u: 2 * fastest - np.abs(x[:, 2]), unit='rad/s')
    monkeypatch.setattr(limited, 'constraints_on', lambda _: (rate,), raising=False)
    (history,) = histories_of(limited, plans)
    assert ([*history.columns], history.units) == (['rate'], {'rate': 'rad/s'})
    extremes = (np.nanmax(history.columns['rate']), np.nanmin(history.columns['rate']))
    assert extremes == pytest.approx((2 * fastest, fastest), rel=1e-2)


def test_a_swing_up_has_every_quantity_with_limits_and_switches(swing_up: Any) -> None:
    problem, solution = swing_up
    vehicles = planned_vehicles(problem, solution.trajectories)
    figure = plot_plan(Mission('', vehicles))
    found = {axis.get_ylabel(): axis for axis in figure.axes}
    quantities = ['theta [rad]', 'psi [rad]', 'theta_dot [rad/s]', 'psi_dot [rad/s]']
    quantities += ['torque [N m]', 'margin of\ntorque [N m]', 'margin of\ndisk_angle [rad]']
    assert list(found) == quantities
    assert sorted(levels(found['torque [N m]'], LIMIT)) == [-0.02, 0.02]
    assert sorted(levels(found['psi [rad]'], LIMIT)) == [-2.0, 2.0]
    torque = solution.trajectory.control('torque')
    jumps = solution.trajectory.times[1:-1][np.diff(torque[:-1]) != 0]
    assert jumps.size
    for axis in figure.axes[:5]:
        assert levels(axis, SWITCH, 'x') == pytest.approx(jumps.tolist())


def test_a_legend_names_what_is_drawn_and_labels_have_room(
    swing_up: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a plant without limits, and with more quantities than fit on a screen."""
    plain = replace(swing_up[1].trajectory, state_names=('x', 'theta', 'v', 'theta_dot'))
    vehicles = planned_vehicles(Foreign(), {'cart': plain})
    (legend,) = filter(None, (axis.get_legend() for axis in plot_plan(Mission('', vehicles)).axes))
    assert [text.get_text() for text in legend.get_texts()] == ['switching points']
    original = swing_up[1].trajectory
    states = (*original.state_names, *(f'quantity_{k}' for k in range(8)))
    many = replace(original, states=np.tile(plain.states, 3), state_names=states, rates=None)
    vehicles = planned_vehicles(PendulumSwingUp(), {'pendulum': many})
    figure = plot_plan(Mission('', vehicles))
    assert figure.get_figheight() > 1.5 * 12
    limit = Constraint('force of the left motor, highest', lambda *_: np.ones(1), unit='x 25 N')
    monkeypatch.setattr(PendulumSwingUp, 'constraints_on', lambda *_: (limit,) * 2)
    figure = plot_plan(Mission('', planned_vehicles(PendulumSwingUp(), {'pendulum': original})))
    figure.canvas.draw()
    boxes = [axis.yaxis.label.get_window_extent() for axis in figure.axes]
    assert all(above.y0 > below.y1 for above, below in itertools.pairwise(boxes))


def test_the_only_distance_of_two_robots_has_no_legend(formation, recwarn):
    problem, solution = formation
    plot_plan(Mission('', planned_vehicles(problem, solution.trajectories)[:2]))
    assert not [warning for warning in recwarn if 'legend' in str(warning.message)]


def test_every_kind_of_file_and_plant(swing_up, formation, tmp_path):
    # names of another plant
    foreign = replace(swing_up[1].trajectory, state_names=('x', 'theta', 'v', 'theta_dot'))
    another: Any = Foreign(), replace(swing_up[1], trajectories={'cart': foreign})
    for (problem, plan), ending, start in (
        (swing_up, '.png', b'\x89PNG'),
        (another, '.pdf', b'%PDF'),
        (formation, '.svg', b'<?xml'),
    ):
        path = tmp_path / f'plan{ending}'
        plot_solution(problem, plan, path)
        assert path.read_bytes().startswith(start)
    assert (tmp_path / 'plan.svg').stat().st_size > 50_000
    (tmp_path / 'full.png').symlink_to('/dev/full')
    with pytest.raises(UnusableFile, match=r'full.png. cannot be written: No space left'):
        plot_solution(*swing_up, tmp_path / 'full.png')

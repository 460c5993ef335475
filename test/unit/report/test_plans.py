# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Reports of plan files by the command; a stated plant judged by its own conditions and limits."""

from dataclasses import replace
import json
from pathlib import Path
import webbrowser

from double_integrator import DoubleIntegrator as Cart
from missions import pendulum_plan, recorded, write
import numpy as np
import pytest
from stated import changed, refused
from tdm_planner.cli import main
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Box, Disc
from tdm_planner.plan_files import plan_document, save_plan
from tdm_planner.plant_views import StatedView
from tdm_planner.problems import DirectProblem, PendulumSwingUp, Problem, RobotFormation, Solution
from tdm_planner.trajectory import Sample, Trajectory
from tdm_sim.processes import make_scene
from tdm_sim.report.animation import scene
from tdm_sim.report.comparison import compare
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle
from tdm_sim.report.page import report_page
from tdm_sim.report.reader import read_mission
from tdm_sim.report.signals import Signals, smallest
from tdm_sim.report.verdict import judge

HALF = {'problem': 'x', **pendulum_plan().to_dict()}


def saved(problem: Problem, file: Path) -> Solution:
    solution = problem.solve()
    save_plan(plan_document(problem, solution), file)
    return solution


def test_a_plan_of_the_pendulum(tmp_path: Path) -> None:
    file = tmp_path / 'plan.json'
    solution = saved(PendulumSwingUp.from_parameters({'limits.torque': 0.05}), file)
    mission = read_mission(file)
    (vehicle,) = mission.vehicles
    assert (vehicle.name, vehicle.view.name) == ('pendulum', 'pendulum')
    plan, planned = vehicle.plans[0].trajectory, solution.trajectory
    np.testing.assert_array_equal(plan.states, planned.states)
    assert (plan.units, vehicle.view.bounds['torque']) == (planned.units, (-0.05, 0.05))
    (figures,) = mission.figures
    assert figures.problem == 'pendulum_swing_up'
    assert (figures.cost, figures.summary) == (solution.cost, solution.summary)
    (missing,) = mission.missing
    assert 'nothing is measured' in missing
    assert not mission.was_executed
    drawn = vehicle.margins
    assert not drawn.measured
    worst = solution.verification.worst['torque']
    assert smallest(drawn.planned)['torque'].worst == pytest.approx(worst)


def test_a_plan_of_robots_and_the_command(tmp_path: Path, capsys, monkeypatch) -> None:
    file = tmp_path / 'plan.json'
    solution = saved(RobotFormation(), file)
    mission = read_mission(file)
    assert [v.name for v in mission.vehicles] == ['robot1', 'robot2', 'robot3']
    assert {v.view.place for v in mission.vehicles} == {('x', 'y')}
    worst = solution.verification.worst
    for vehicle in mission.vehicles:
        planned = smallest(vehicle.margins.planned)
        assert set(planned) == {'thrust', 'thruster_rate', 'torque', 'walls'}
        # of the thrust the upper limit alone: robots that coast are at the lower one
        strongest = vehicle.plans[0].trajectory.control('thrust').max()
        least = vehicle.view.bounds['thrust'][1] - strongest
        assert planned['thrust'].worst == pytest.approx(least)
        for name in ('thruster_rate', 'torque', 'walls'):
            expected = pytest.approx(worst[f'{vehicle.name}.{name}'], abs=1e-4)
            assert planned[name].worst == expected
    (nearest,) = [e for e in compare(mission).entries if e.name == 'smallest distance']
    apart = min(v for n, v in worst.items() if n.startswith('separation'))
    assert nearest.planned == pytest.approx(0.4 + apart, abs=1e-3)
    assert nearest.achieved is None
    monkeypatch.chdir(tmp_path)
    plan = str(file)
    assert main(['report', plan]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith(f'reading {plan}')
    assert lines[-1] == 'written to report.html'
    page = Path('report.html').read_text()
    assert 'robots in formation after' in page
    assert 'nothing is measured' in page
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, 'open', opened.append)
    page_file = Path('a page.htm')
    assert main(['report', plan, '-o', str(page_file), '--view', '--quiet']) == 0
    assert capsys.readouterr() == ('', '')
    assert page_file.read_text() == page
    assert opened == [page_file.absolute().as_uri()]


def test_a_third_partys_plan_without_parameters(tmp_path: Path) -> None:
    plan = {'problem': 'crane', 'cost': 2.0, 'times': [0.0, 1.0], 'interpolation': 'linear'}
    plan |= {'states': {'sway': [0.0, 1.0]}, 'controls': {'force': [1.0, 1.0]}}
    (tmp_path / 'plan.json').write_text(json.dumps(plan))
    mission = read_mission(tmp_path / 'plan.json')
    assert mission.vehicles[0].view.problem is None
    (figures,) = mission.figures
    assert (figures.cost, figures.solve_time) == (2.0, None)
    assert any('parameters' in text for text in mission.missing)
    assert not mission.vehicles[0].margins.planned
    (tmp_path / 'plan.json').write_text(json.dumps(plan | {'problem': '<b>\n' * 300}))
    assert read_mission(tmp_path / 'plan.json').figures[0].problem.isprintable()
    for name, strange in (
        *(('cost', 'cheap'), ('solve_time', [1]), ('verification', []), ('parameters', [1])),
        *(('cost_terms', {'a': None}), ('cost', 10**400), ('vehicles', {'a': {'states': []}})),
    ):
        (tmp_path / 'plan.json').write_text(json.dumps(plan | {name: strange}))
        assert refused(lambda: read_mission(tmp_path / 'plan.json'))


@pytest.mark.parametrize(
    'content',
    [
        *(b'', b'\xff\xfe\x00', b'[1, 2]', b'{"a": 1}', b'{"problem": "x"}', b'[' * 100_000),
        *({'problem': 'x', 'robots': robots} for robots in (3, {'a': 3}, {})),
        *(b'{', {'problem': 'x', 'times': [1]}),
        *(HALF | wrong for wrong in ({'times': 'abc'}, {'units': [1]})),
        *(HALF | wrong for wrong in ({'states': {'a': [1, 'x']}}, {'interpolation': ['linear']})),
        json.dumps(HALF).replace('0.014', 'NaN').encode(),
    ],
)
def test_what_is_no_plan_is_refused_in_one_sentence(tmp_path: Path, content) -> None:
    """By the reader of reports, as by `load_plan`, which it calls."""
    path = tmp_path / 'plan.json'
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    assert refused(lambda: read_mission(path))


LENGTH = 2.0  # s
Sled = changed(
    Cart,
    name='sled',
    margins=DirectProblem.margins,
    final_cost=DirectProblem.final_cost,
    outputs=lambda s: {'x': Output(start=(0.0, 0.0), end=(1.0, 0.0))},
    duration=lambda s: Duration(guess=LENGTH),
    control_limits=lambda s: {'u': (-s.limit, s.limit)},
    joints=lambda s: {'runner': ('x', 'v')},
    drawing=lambda s, x: [Disc((x[0], 0.0), 0.1, trail=True)],
)
Passing = changed(
    Sled,
    outputs=lambda s: {'x': Output(start=(0.0, 0.0), end=(1.0,))},
    end_conditions=lambda s, t, x: (x[1] - 1.5,),
)
Stretched = changed(Cart, drawing=lambda s, x: [Box((x[0], 0.0), (0.1, 0.1 + x[0] ** 2))])
Swollen = changed(Cart, drawing=lambda s, x: [Disc((x[0], 0.0), 0.1 + x[0] ** 2)])
Misdrawn = changed(Sled, drawing=lambda s, x: [Disc((x[7], 0.0), 0.1)])
SLED, PASSING = Sled(limit=2.0), Passing(limit=2.0)


def cubic(end: float) -> Trajectory:
    t = np.linspace(0.0, LENGTH, 81)
    b, a = 3 / LENGTH**2 - end / LENGTH, end / LENGTH**2 - 2 / LENGTH**3
    states = np.stack([b * t**2 + a * t**3, 2 * b * t + 3 * a * t**2], axis=1)
    controls, units = (2 * b + 6 * a * t)[:, None], ('m', 'm/s')
    return Trajectory(t, states, controls, ('x', 'v'), ('u',), 'linear', units, ('m/s^2',))


def mission(problem: DirectProblem, end: float, until: float = 9.0, **off: float) -> Mission:
    motion = cubic(end)
    at = np.arange(0.0, until, 0.01)
    states, controls = motion.sample(np.minimum(at, LENGTH))
    states = states + np.array([off.get('x', 0.0), off.get('v', 0.0)])
    controls = (at[:, None] < LENGTH) * controls + off.get('u', 0.0)
    states, commands = Signals.both(motion, at, Sample(states, controls))
    measured = {'states': states, 'commands': commands}
    plans = (FollowedPlan(motion, 0.0),)
    vehicle = RecordedVehicle('sled', StatedView(problem), plans, **measured)
    return Mission('Sled', (vehicle,))


def judged(problem: DirectProblem, end: float, **changes):
    return judge(mission(problem, end, **changes))


def test_a_goal_that_can_be_held_must_be() -> None:
    assert judged(SLED, 0.0).reached
    (reason,) = judged(SLED, 0.0, x=0.06).reasons
    assert reason == 'sled was not at its goal within 1 s of the planned end: off in x by 0.06 m'
    assert judged(SLED, 0.0, until=6.5).undecided.startswith('the recording ends at 6.5 s')
    # limits leave the feedback some room
    assert judged(SLED, 0.0, u=0.55).reached  # 2.5 % above 2 m/s^2
    saturated = mission(SLED, 0.0)
    saturated.vehicles[0].commands.columns['u'][60] = 2.0
    marks = {e.name: e.mark for e in compare(saturated).entries}
    assert (marks['margin of u, highest'], marks['margin of u, lowest']) == ('saturated', '')
    (reason,) = judged(SLED, 0.0, u=0.7).reasons
    assert "violated the limit 'u, highest' by 0.0" in reason


@pytest.mark.parametrize('unit', [1e-3, 1.0 / 3.0, 1.0, 1e3])
def test_what_a_limit_may_be_violated_by_does_not_depend_on_its_unit(unit: float) -> None:
    """Whether it is stated as what is left, as a share of that, or in another unit."""
    fastest = 1.5 / LENGTH  # as planned, from rest
    names = {'name': 'sled', 'margins': lambda s, t, x, u: {'speed': unit * (fastest - x[1])}}
    problem = changed(Sled, **names)(limit=2.0)
    for share, reached in ((0.04, True), (0.06, False)):
        flown = mission(problem, 0.0)
        (vehicle,) = flown.vehicles
        vehicle.states.columns['v'][60] = (1.0 + share) * fastest
        (plan,) = vehicle.plans
        states = plan.trajectory.states
        rest = replace(plan.trajectory, states=states[-1] + 1e-3 * (states - states[-1]))
        again = replace(vehicle, plans=(plan, FollowedPlan(rest, 5.0)))  # little is left of it
        for judged in (vehicle, again):
            verdict = judge(replace(flown, vehicles=(judged,)))
            assert verdict.reached is reached, verdict
            assert reached or "violated the limit 'speed' by" in verdict.reasons[0]


def test_of_a_motion_that_is_not_held_its_end_counts_where_it_is_stated() -> None:
    """What is free is not judged, what comes afterwards neither."""
    assert judged(PASSING, 1.5).title == 'Goal reached in passing'
    assert judged(PASSING, 1.5, v=0.02).reached
    assert 'off in x by 0.1 m' in judged(PASSING, 1.5, x=0.1).reasons[0]
    assert 'end condition 0' in judged(PASSING, 1.5, v=0.2).reasons[0]
    assert judged(PASSING, 1.5, until=1.5).undecided
    # nor is it told of limits
    flown = mission(PASSING, 1.5)
    flown.vehicles[0].commands.columns['u'][-100:] = 9.0
    (margin,) = (e for e in compare(flown).entries if e.name == 'margin of u, highest')
    assert margin.achieved == pytest.approx(margin.planned, abs=0.1)


def test_a_recording_of_it_is_judged_where_the_class_is_given(tmp_path: Path) -> None:
    sled = replace(mission(SLED, 0.0), parameters={'limit': 2.0})
    bag = write(tmp_path / 'bag', recorded(sled, '/sled'))
    found = judge(read_mission(bag, problem=Sled))
    assert found.reached, found
    drawn = scene(read_mission(bag, problem=Sled))
    assert [shape['kind'] for shape in drawn['vehicles'][0]['measured']] == ['disc']
    # what a recording names is not imported
    assert judge(read_mission(bag)) is None
    assert any("'sled' is not installed" in text for text in read_mission(bag).missing)


@pytest.mark.parametrize(('name', 'what'), [('Stretched', 'Box.size'), ('Swollen', 'Disc.radius')])
def test_a_size_that_depends_on_the_state_is_refused_at_once(capsys, tmp_path, name, what):
    problem, file = f'{__name__}:{name}', tmp_path / 'plan.json'
    assert main(['plan', problem, '-o', str(file)]) == main(['check', problem]) == 2
    told = capsys.readouterr().err.strip().split('\n')
    assert len(set(told)) == 1
    assert f'{what} must be constant: it cannot depend on the states' in told[0]
    assert 'in line' in told[0]
    assert not file.exists()
    assert refused(lambda: make_scene(problem)) in told[0]


def test_a_drawing_that_fails_costs_no_report() -> None:
    page = report_page(replace(mission(Misdrawn(limit=2.0), 0.0), missing=('No tea.',)))
    assert 'No tea.' in page
    assert 'There is no picture: drawing of Changed raises IndexError' in page
    assert 'Goal reached and held' in page

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from page_missions import pendulum_plan
import pytest
from tdm_planner.exceptions import TdmError
from tdm_planner.plan_files import plan_document, save_plan
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_sim.report.comparison import compare
from tdm_sim.report.reader import read_mission


def test_a_plan_of_the_pendulum(tmp_path: Path):
    problem = PendulumSwingUp.from_parameters({'limits.torque': 0.05})
    solution = problem.solve(deadline=5.0)
    save_plan(plan_document(problem, solution), tmp_path / 'plan.json')
    mission = read_mission(tmp_path / 'plan.json')
    (vehicle,) = mission.vehicles
    assert (vehicle.name, vehicle.plant, mission.problem) == (
        'pendulum', 'pendulum', 'pendulum_swing_up',
    )  # fmt: skip
    plan = vehicle.plans[0].trajectory
    np.testing.assert_array_equal(plan.states, solution.trajectory.states)
    assert plan.units == solution.trajectory.units
    assert mission.number('limits.torque') == 0.05
    (figures,) = mission.figures
    assert figures.cost == solution.cost
    assert figures.summary == solution.summary
    assert figures.margins['torque'].worst == solution.verification.worst['torque']
    assert figures.margins['torque'].instant == solution.verification.worst_times['torque']
    assert figures.margins['torque'].unit == 'N m'
    assert 'nothing is measured' in mission.missing[0]
    assert len(mission.missing) == 1
    assert not mission.was_carried_out
    drawn = compare(mission).margins['pendulum']
    assert drawn.measured is None
    assert drawn.planned is not None
    assert drawn.planned.column('torque').min() == pytest.approx(figures.margins['torque'].worst)


def test_a_plan_of_robots(tmp_path: Path):
    problem = RobotFormation()
    solution = problem.solve(deadline=10.0)
    save_plan(plan_document(problem, solution), tmp_path / 'plan.json')
    mission = read_mission(tmp_path / 'plan.json')
    assert [v.name for v in mission.vehicles] == ['robot1', 'robot2', 'robot3']
    assert {v.plant for v in mission.vehicles} == {'robot'}
    assert mission.numbers('formation.robot2') is not None
    comparison = compare(mission)
    check = solution.verification
    for vehicle in mission.vehicles:
        planned = comparison.margins[vehicle.name].planned
        assert planned is not None
        assert set(planned.names) == {'thrust', 'thruster_rate', 'torque', 'walls'}
        # of the thrust the upper limit alone: robots that coast are at the lower one
        most = mission.number('limits.thrust')
        assert most is not None
        strongest = vehicle.plans[0].trajectory.control('thrust').max()
        assert planned.column('thrust').min() == pytest.approx(most - strongest)
        for name in planned.names[1:]:
            expected = check.worst[f'{vehicle.name}.{name}']
            assert planned.column(name).min() == pytest.approx(expected, abs=1e-4)
    (smallest,) = [e for e in comparison.entries if e.name == 'smallest distance of two robots']
    apart = min(v for n, v in check.worst.items() if n.startswith('separation'))
    assert smallest.planned == pytest.approx(0.4 + apart, abs=1e-3)
    assert smallest.achieved is None


def test_a_third_partys_plan_without_parameters(tmp_path: Path):
    plan = {
        'problem': 'crane',
        'cost': 2.0,
        'times': [0.0, 1.0],
        'states': {'sway': [0.0, 1.0]},
        'controls': {'force': [1.0, 1.0]},
        'interpolation': 'linear',
    }
    (tmp_path / 'plan.json').write_text(json.dumps(plan))
    mission = read_mission(tmp_path / 'plan.json')
    (vehicle,) = mission.vehicles
    assert vehicle.plant == 'other'
    assert mission.figures[0].cost == 2.0
    assert mission.figures[0].solve_time is None
    assert [text for text in mission.missing if 'parameters' in text]
    assert [text for text in mission.missing if 'margins' in text]
    assert compare(mission).margins['vehicle'].planned is None


HALF = {'problem': 'x', **pendulum_plan().to_dict()}


@pytest.mark.parametrize(
    'content',
    [
        b'',
        b'\xff\xfe\x00',
        b'[1, 2]',
        b'{"a": 1}',
        b'{"problem": "x"}',
        b'[' * 100_000,
        json.dumps({'problem': 'x', 'robots': 3}).encode(),
        json.dumps({'problem': 'x', 'robots': {'a': 3}}).encode(),
        json.dumps({**HALF, 'times': 'abc'}).encode(),
        json.dumps({**HALF, 'states': {'a': [1, 'x']}}).encode(),
        json.dumps({**HALF, 'units': [1]}).encode(),
        json.dumps({**HALF, 'interpolation': ['linear']}).encode(),
        json.dumps(HALF).replace('0.014', 'NaN').encode(),
    ],
)
def test_what_is_no_plan_is_refused_in_one_sentence(tmp_path: Path, content: bytes):
    path = tmp_path / 'plan.json'
    path.write_bytes(content)
    with pytest.raises(TdmError) as caught:
        read_mission(path)
    assert '\n' not in str(caught.value)


def test_strange_figures_are_left_out(tmp_path: Path):
    document = {
        **HALF,
        'problem': '<b>\n' * 300,
        'cost': 'cheap',
        'solve_time': [1],
        'verification': [],
        'cost_terms': {'a': None, 'b': 2},
        'parameters': {'x': {'y': 1}, 'z': [1, [2]]},
    }
    path = tmp_path / 'plan.json'
    path.write_text(json.dumps(document))
    mission = read_mission(path)
    figures = mission.figures[0]
    assert (figures.cost, figures.solve_time, figures.cost_terms) == (None, None, {'b': 2.0})
    assert mission.parameters == {'x': None, 'z': [1, None]}
    assert mission.problem.isprintable()
    compare(mission)

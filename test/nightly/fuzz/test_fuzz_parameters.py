# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Any parameters: a verified plan, a reasoned failure, or a refusal that names the field."""

from __future__ import annotations

from typing import Any

from fuzz_corpus import corpus
from fuzz_judges import outcome, planned
from fuzz_profiles import cases
from fuzz_strategies import anything, forbidden_settings, parameter_sets
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import Infeasible, InvalidProblem, TdmError
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.base import Problem, Solution

PENDULUM = PendulumSwingUp.parameter_specifications({})
ROBOTS = RobotFormation.parameter_specifications({})
PROBLEMS: dict[str, type[Problem]] = {
    'pendulum_swing_up': PendulumSwingUp,
    'robot_formation': RobotFormation,
}
PATIENCE = 1.0  # s for problems that can be solved


@cases(70)
@given(parameter_sets(PENDULUM))
def test_a_pendulum_is_planned_for_or_refused(parameters: dict[str, Any]) -> None:
    planned(PendulumSwingUp, parameters)


@cases(70)
@given(parameter_sets(ROBOTS))
def test_robots_are_planned_for_or_refused(parameters: dict[str, Any]) -> None:
    planned(RobotFormation, parameters)


@st.composite
def arenas(draw: Any) -> dict[str, Any]:
    """Robots anywhere in an arena: mostly valid, often too near to one another or to a wall."""
    names = [f'robot{k + 1}' for k in range(draw(st.integers(1, 4)))]
    place = st.floats(0.1, 3.9)
    values: dict[str, Any] = {
        'robots': names,
        'formation.anchor': [2.0, 2.0, draw(st.floats(-4.0, 4.0))],
        'arena.minimum_separation': draw(st.sampled_from([0.05, 0.3, 0.4, 0.6, 5.0])),
    }
    for name in names:
        for axis in 'xy':
            values[f'{name}.start.{axis}'] = draw(place)
        for axis in ('u', 'v', 'omega'):
            values[f'{name}.start.{axis}'] = draw(st.sampled_from([0.0, 0.0, 0.05, -0.2, 3.0]))
        offset = st.floats(-1.5, 1.5)
        values[f'formation.{name}'] = [draw(offset), draw(offset), draw(st.floats(-7.0, 7.0))]
    if draw(st.booleans()):
        values['arena.obstacles'] = [draw(place), draw(place), draw(st.floats(0.05, 0.5))]
    return values


@cases(30)
@given(arenas())
def test_robots_anywhere_are_planned_for_or_refused(parameters: dict[str, Any]) -> None:
    planned(RobotFormation, parameters)


@st.composite
def moderate_pendulums(draw: Any) -> dict[str, Any]:
    """Nothing that anybody could object to: a rig like the real one, at a speed it can have."""
    angle = draw(st.floats(0.8, 3.0))
    size = st.floats(0.8, 1.25)
    return {
        **{f'plant.{name}': draw(size) * PENDULUM[f'plant.{name}'].default
           for name in ('mass', 'com_distance', 'arm_length', 'inertia.disk')},
        'limits.torque': draw(st.floats(0.03, 0.2)),
        'limits.disk_angle': angle,
        'torque_reserve': draw(st.floats(0.0, 0.3)),
        'start.theta': draw(st.floats(-4.0, 4.0)),
        'start.psi': draw(st.floats(-0.5, 0.5)) * angle,
        'start.theta_dot': draw(st.floats(-2.0, 2.0)),
        'start.psi_dot': draw(st.floats(-1.0, 1.0)),
    }  # fmt: skip


@st.composite
def moderate_arenas(draw: Any) -> dict[str, Any]:
    """One to three robots at rest, well apart from one another and from the walls."""
    places = [(0.7 + 1.3 * (k % 3), 0.7 + 1.3 * (k // 3)) for k in range(9)]
    count = draw(st.integers(1, 3))
    chosen = draw(st.lists(st.sampled_from(places), min_size=count, max_size=count, unique=True))
    near = st.floats(-0.2, 0.2)
    values: dict[str, Any] = {
        'robots': [f'robot{k + 1}' for k in range(count)],
        'formation.anchor': [2.0 + draw(near), 2.0 + draw(near), draw(st.floats(-3.0, 3.0))],
        'limits.thrust': draw(st.floats(0.8, 3.0)),
        'plant.mass': draw(st.floats(8.0, 13.0)),
        'weights.gas': draw(st.floats(0.0, 0.9)),
    }
    for k, (x, y) in enumerate(chosen):
        values |= {
            f'robot{k + 1}.start.x': x + draw(near),
            f'robot{k + 1}.start.y': y + draw(near),
        }
        values[f'robot{k + 1}.start.yaw'] = draw(st.floats(-3.0, 3.0))
    return values


@pytest.mark.parametrize(
    ('problem', 'strategy'),
    [(PendulumSwingUp, moderate_pendulums()), (RobotFormation, moderate_arenas())],
    ids=list(PROBLEMS),
)
def test_what_is_valid_is_never_refused_and_often_planned_for(
    problem: type[Problem], strategy: Any
) -> None:
    """Whoever refuses everything would pass all other tests here."""
    found: list[Solution | TdmError] = []

    @cases(12)
    @given(strategy)
    def ask(parameters: dict[str, Any]) -> None:
        found.append(planned(problem, parameters, PATIENCE))
        assert not isinstance(found[-1], InvalidProblem), (str(found[-1]), parameters)

    ask()
    plans = sum(isinstance(answer, Solution) for answer in found)
    print(f'{problem.__name__}: {plans} plans of {len(found)} problems')
    assert plans >= len(found) / 4


@cases(60)
@given(
    st.one_of(
        st.tuples(st.just('pendulum_swing_up'), forbidden_settings(PENDULUM)),
        st.tuples(st.just('robot_formation'), forbidden_settings(ROBOTS)),
    )
)
def test_what_is_not_allowed_is_refused_by_name(case: Any) -> None:
    problem, (name, value) = case
    error = outcome(lambda: PROBLEMS[problem].from_parameters({name: value}), case)
    assert isinstance(error, InvalidProblem), (name, value, error)
    assert name in str(error) or (name == 'robots' and "'robots'" in str(error))


@cases(20)
@given(anything)
def test_parameters_that_are_no_mapping_are_refused(value: Any) -> None:
    found = outcome(lambda: PendulumSwingUp.from_parameters(value), value)
    assert isinstance(found, (InvalidProblem, PendulumSwingUp))


@pytest.mark.parametrize('name', ['deadline', 'seed'])
@pytest.mark.parametrize('value', [float('nan'), float('inf'), -1, -(10**400), 'soon', True, [1]])
def test_arguments_of_a_search_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(InvalidProblem, match=name):
        PendulumSwingUp().solve(**{name: value})


@pytest.mark.parametrize(
    'value',
    [10**5000, np.array(1.0), np.array([1.0, 2.0]), b'1', {1}, 1j],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize('name', ['limits.torque', 'solver.seed', 'goal.turns'])
def test_odd_values_of_python_are_refused_by_name(name: str, value: Any) -> None:
    if name == 'limits.torque' and np.shape(value) == () and isinstance(value, np.ndarray):
        assert PendulumSwingUp.from_parameters({name: value}).limits.torque == 1.0
        return
    with pytest.raises(InvalidProblem, match=name):
        PendulumSwingUp.from_parameters({name: value})


@pytest.mark.parametrize('case', corpus('parameters'))
def test_what_once_escaped_does_so_no_more(case: dict[str, Any]) -> None:
    problem = PROBLEMS[case['problem']]
    assert isinstance(planned(problem, case['parameters']), (Solution, Infeasible, InvalidProblem))

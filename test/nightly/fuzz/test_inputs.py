# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Thousands of new cases of bad input; what is valid is never refused, and often planned for."""

from __future__ import annotations

from typing import Any

from fuzzing import planned, profile, PROPERTIES, SPECIFICATIONS, try_out
from hypothesis import given
from hypothesis import strategies as st
import pytest
from tdm_planner.exceptions import InvalidProblem, TdmError
from tdm_planner.problems.base import Solution

PENDULUM = SPECIFICATIONS['pendulum_swing_up']
FACTOR = 35  # above 10,000 cases
PATIENCE = 1.0  # s for problems that can be solved


@pytest.mark.parametrize('name', PROPERTIES)
def test_bad_input_is_met_with_a_result_or_a_reason(name: str) -> None:
    try_out(name, FACTOR)


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
    chosen = draw(st.lists(st.sampled_from(places), min_size=1, max_size=3, unique=True))
    near = st.floats(-0.2, 0.2)
    values: dict[str, Any] = {
        'robots': [f'robot{k + 1}' for k in range(len(chosen))],
        'formation.anchor': [2.0 + draw(near), 2.0 + draw(near), draw(st.floats(-3.0, 3.0))],
        'limits.thrust': draw(st.floats(0.8, 3.0)),
        'weights.gas': draw(st.floats(0.0, 0.9)),
    }
    for name, (x, y) in zip(values['robots'], chosen, strict=True):
        values |= {f'{name}.start.x': x + draw(near), f'{name}.start.y': y + draw(near)}
    return values


@pytest.mark.parametrize(
    ('problem', 'strategy'),
    [('pendulum_swing_up', moderate_pendulums()), ('robot_formation', moderate_arenas())],
)
def test_what_is_valid_is_never_refused_and_often_planned_for(problem: str, strategy: Any) -> None:
    """Whoever refuses everything would pass all other tests here."""
    found: list[Solution | TdmError] = []

    @profile(250, new=True)
    @given(strategy)
    def ask(parameters: dict[str, Any]) -> None:
        found.append(planned(problem, parameters, PATIENCE))
        assert not isinstance(found[-1], InvalidProblem), (str(found[-1]), parameters)

    ask()
    made = sum(isinstance(answer, Solution) for answer in found)
    print(f'{problem}: {made} plans of {len(found)} problems')
    assert made >= len(found) / 4

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Formations with robots added or left out."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems.formation_size import resized


def test_fewer_robots_are_the_first_ones():
    assert resized({}, 2) == {'robots': ['robot1', 'robot2']}
    assert resized({'robots': ['left', 'right']}, 1) == {'robots': ['left']}
    assert resized({'robots': ['left', 'right']}, 2) == {'robots': ['left', 'right']}


def test_added_robots_get_names_that_are_free():
    names = resized({'robots': ['robot2', 'left']}, 5)['robots']
    assert names == ['robot2', 'left', 'robot1', 'robot3', 'robot4']
    # Robots without a start are measured, and no hindrance.
    made = resized({'robots': ['left'], 'formation.left': [0.0, 0.0, 0.0]}, 2)
    assert 'left.start.x' not in made
    assert made['formation.robot1'][:2] != [0.0, 0.0]


@settings(max_examples=15)
@given(
    number=st.integers(1, 12),
    length=st.floats(3.5, 8.0),
    width=st.floats(3.5, 8.0),
    zone=st.tuples(st.floats(1.0, 3.0), st.floats(0.5, 1.0), st.floats(0.05, 0.3)),
    yaw=st.floats(-3.0, 3.0),
)
def test_places_are_clear_of_each_other_and_of_the_arena(
    number: int, length: float, width: float, zone: tuple[float, ...], yaw: float
):
    values: dict[str, Any] = {
        'robots': ['first'],
        'first.start.x': 0.5,
        'first.start.y': 3.0,
        'formation.first': [0.3, 0.0, 0.0],
        'formation.anchor': [1.7, 2.0, yaw],
        'arena.length': length,
        'arena.width': width,
        'arena.obstacles': list(zone),
    }
    try:
        values |= resized(values, number)
    except InvalidProblem as error:
        assert 'room in the arena' in str(error)
        return
    names = values['robots']
    assert len(set(names)) == number
    anchor = np.array(values['formation.anchor'])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    starts = np.array([[values[f'{n}.start.x'], values[f'{n}.start.y']] for n in names])
    goals = np.array([anchor[:2] + turn @ values[f'formation.{n}'][:2] for n in names])
    for places in (starts, goals):
        apart = np.linalg.norm(places[:, None] - places, axis=2) + 1e3 * np.eye(number)
        assert apart.min() >= 0.6 - 1e-5
        added = places[1:]
        assert (added >= 0.4 - 1e-5).all()
        assert (added <= np.array([length, width]) - 0.4 + 1e-5).all()
        away = np.linalg.norm(added - np.array(zone[:2]), axis=1)
        assert (away >= zone[2] + 0.4 - 1e-5).all()


@pytest.mark.parametrize(
    ('number', 'reason'), [(0, 'must be in'), (101, 'must be in'), (60, '60')]
)
def test_numbers_that_cannot_be_are_refused(number: int, reason: str):
    with pytest.raises(InvalidProblem, match=f'number_of_robots = .*{reason}'):
        resized({}, number)

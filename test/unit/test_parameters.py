# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from dataclasses import dataclass
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import (
    build,
    flatten,
    group,
    parameter,
    POSITIVE,
    Range,
    ros_parameters,
    specifications,
    to_mapping,
    Validated,
)


@dataclass(frozen=True)
class Inner(Validated):
    mass: float = parameter(1.0, 'mass', unit='kg', allowed=POSITIVE)
    turns: int | None = parameter(None, 'turns')


@dataclass(frozen=True)
class Outer(Validated):
    share: float = parameter(0.2, 'share', allowed=Range(0.0, 1.0, upper_open=True))
    method: str = parameter('a', 'method', choices=('a', 'b'))
    names: list[str] = parameter(['x'], 'names')
    anchor: list[float] = parameter([0.0, 0.0], 'anchor', length=2)
    plant: Inner = group(Inner)


def test_names_and_round_trip():
    assert list(specifications(Outer)) == [
        'share', 'method', 'names', 'anchor', 'plant.mass', 'plant.turns',
    ]  # fmt: skip
    values = {'share': 0.5, 'plant.mass': 2, 'plant.turns': 3, 'names': ['p', 'q']}
    made = build(Outer, values)
    assert made.plant == Inner(2.0, 3)
    assert isinstance(made.plant.mass, float)
    assert build(Outer, to_mapping(made)) == made


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('plant.mass', -0.1, ['plant.mass', '-0.1', '(0, 1e+12] kg']),
        ('plant.mass', 0, ['plant.mass', '0', '(0, 1e+12] kg']),
        ('plant.mass', math.nan, ['plant.mass', 'nan']),
        ('plant.mass', math.inf, ['plant.mass', 'inf']),
        ('plant.mass', 'heavy', ['plant.mass', "'heavy'", 'a number']),
        ('plant.mass', True, ['plant.mass', 'True']),
        ('plant.mass', [1.0], ['plant.mass', '[1.0]']),
        ('plant.mass', 10**400, ['plant.mass', 'a number']),
        ('plant.turns', 1.5, ['plant.turns', '1.5', 'an integer']),
        ('share', 1.0, ['share', '1.0', '[0, 1)']),
        ('method', 'c', ['method', "'c'", 'one of a, b']),
        ('names', 'x', ['names', "'x'", 'a list of strings']),
        ('names', [1], ['names', '[1]']),
        ('anchor', [1.0], ['anchor', '[1.0]', '2 numbers']),
        ('anchor', [1.0, math.nan], ['anchor', 'nan']),
    ],
)
def test_one_sentence_names_parameter_value_and_range(name, value, words):
    with pytest.raises(InvalidProblem) as refused:
        build(Outer, {name: value})
    message = str(refused.value)
    assert all(word in message for word in words), message
    assert '\n' not in message


def test_dataclasses_check_themselves():
    with pytest.raises(InvalidProblem, match='mass'):
        Inner(mass=-1.0)


@given(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.binary(),
        st.lists(st.floats()), st.lists(st.text()), st.dictionaries(st.text(), st.integers()),
    ),
    st.sampled_from(list(specifications(Outer))),
)  # fmt: skip
@settings(deadline=None, max_examples=300, derandomize=True)
def test_any_value_is_taken_or_refused_in_one_line(value, name):
    spec = specifications(Outer)[name]
    try:
        taken = spec.check(value)
    except InvalidProblem as refused:
        assert name in str(refused)
        assert '\n' not in str(refused)
    else:
        assert spec.check(taken) == taken


def test_flatten():
    assert flatten({'a': {'b': {'c': 1}, 'd': 2}, 'e.f': 3}) == {'a.b.c': 1, 'a.d': 2, 'e.f': 3}


@pytest.mark.parametrize(
    'document',
    [
        {'planner': {'ros__parameters': {'a': {'b': 1}}}},
        {'/**': {'planner': {'ros__parameters': {'a': {'b': 1}}}}},
        {'/**/planner': {'ros__parameters': {'a.b': 1}}},
        {'/pendulum/planner': {'ros__parameters': {'a': {'b': 1}}}, 'x': {'ros__parameters': {}}},
        {'/**': {'ros__parameters': {'a': {'b': 1}}}},
        {'a': {'b': 1}},
    ],
)
def test_ros_parameter_files_in_every_form(document):
    assert ros_parameters(document) == {'a.b': 1}


def test_files_for_others_are_empty_where_no_section_is_required():
    document = {'tracker': {'ros__parameters': {'a': 1}}}
    assert ros_parameters(document, required=False) == {}


@pytest.mark.parametrize('document', [[1], 'text', {'tracker': {'ros__parameters': {'a': 1}}}])
def test_files_for_others_are_refused(document):
    with pytest.raises(InvalidProblem):
        ros_parameters(document)

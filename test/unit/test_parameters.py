# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Declared parameters: checked, read from files, written to files and tables."""

from __future__ import annotations

from dataclasses import dataclass
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from ros_harness import SOURCE
from stated import refused
from tdm_planner import parameters
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import ros_parameters
from tdm_planner.parameters import build, group, parameter, specifications, to_mapping, Validated
from tdm_planner.problems import RobotFormation
from tools.parameter_texts import parameter_file, yaml_value
import yaml


@dataclass(frozen=True)
class Inner(Validated):
    mass: float = parameter(1e-8, 'mass', unit='kg', allowed=parameters.POSITIVE)
    turns: int | None = parameter(None, 'turns')


@dataclass(frozen=True)
class Optional(Validated):
    limit: float | None = parameter(None, 'limit')


@dataclass(frozen=True)
class Outer(Validated):
    share: float = parameter(0.2, 'share', allowed=parameters.Range(0.0, 1.0, upper_open=True))
    on: bool = parameter(True, 'switch')
    names: list[str] = parameter(['x', 'no'], 'names')
    anchor: list[float] = parameter([0.0, 0.0], 'anchor', length=2)
    zones: list[float] = parameter([], 'zones', multiple=3)
    plant: Inner = group(Inner)
    method: str = parameter('a', 'the method', choices=('a', 'b'), read_only=True)
    optional: Optional = group(Optional)
    wordy: float = parameter(1.0, 'many words ' * 40)


SPECS = specifications(Outer)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
WHOLE = st.integers(-(2**63), 2**63 - 1)


@pytest.mark.parametrize('value', [{'mass': 1.0}, None, 3])
def test_a_group_is_no_mapping(value):
    """A mapping was accepted, and an AttributeError came from somewhere later."""
    with pytest.raises(
        InvalidProblem, match=r"'plant' = .*: must be an instance of its class; from_"
    ):
        Outer(plant=value)


def test_names_and_round_trip():
    every = 'share on names anchor zones plant.mass plant.turns method optional.limit wordy'
    assert list(SPECS) == every.split()
    values = {'share': 0.5, 'plant.mass': 2, 'plant.turns': 3, 'names': ['p', 'q']}
    made = build(Outer, values)
    assert made.plant == Inner(2.0, 3)
    assert isinstance(made.plant.mass, float)
    assert build(Outer, to_mapping(made)) == made
    with pytest.raises(InvalidProblem, match='mass'):
        Inner(mass=-1.0)
    flat = parameters.flatten({'a': {'b': {'c': 1}, 'd': 2}, 'e.f': 3})
    assert flat == {'a.b.c': 1, 'a.d': 2, 'e.f': 3}
    for mapping in ({'a': {'b': 1}, 'a.b': 2}, {'a.b': 2, 'a': {'b': 1}}):
        with pytest.raises(InvalidProblem, match=r"parameter 'a\.b' is given twice, once nested"):
            parameters.flatten(mapping)


@pytest.mark.parametrize(
    ('name', 'value', 'allowed'),
    [
        *(('plant.mass', value, '[1e-12, 1e+12] kg') for value in (-0.1, 0)),
        *(('plant.mass', value, '') for value in (math.nan, math.inf, True, [1.0])),
        *(('plant.mass', value, 'a number') for value in ('heavy', 10**400)),
        ('plant.turns', 1.5, 'an integer'),
        ('share', 1.0, '[0, 1)'),
        ('method', 'c', 'one of a, b'),
        *(('names', value, 'a list of strings') for value in ('x', [1])),
        *(('anchor', value, '2 numbers') for value in ([1.0], [1.0, math.nan])),
        ('zones', [1.0, 2.0], 'a list of 0, 3, 6, ... numbers'),
    ],
)
def test_one_sentence_names_parameter_value_and_range(name, value, allowed):
    message = refused(lambda: build(Outer, {name: value}))
    words = [name, allowed] if value == 10**400 else [name, repr(value), allowed]
    assert all(word in message for word in words), message


def read(text: str, node: str = 'node') -> dict:
    return ros_parameters(yaml.safe_load(text), node)


def test_a_file_holds_the_defaults_or_values_by_node_and_says_what_is_allowed():
    text = parameter_file({'node': (SPECS, {}), 'other': (SPECS, {'method': 'b'})}, 'Title\nline')
    assert text.startswith('# Title\n# line\n/**/node:\n  ros__parameters:\n')
    unset = ('zones', 'plant.turns', 'optional.limit')
    defaults = to_mapping(Outer())
    assert read(text) == {name: defaults[name] for name in SPECS if name not in unset}
    assert read(text, 'other')['method'] == 'b'
    assert '      # mass [kg], in [1e-12, 1e+12]\n      mass: 1.0e-08\n' in text
    assert '    # the method: a, b\n' in text
    assert '      # turns:\n' in text
    assert max(map(len, text.splitlines())) <= 99
    assert read(parameter_file({'node': (SPECS, {'plant.turns': 2})}))['plant.turns'] == 2
    with pytest.raises(InvalidProblem, match=r"'plant\.mass' = -1"):
        parameter_file({'node': (SPECS, {'plant.mass': -1})})
    with pytest.raises(KeyError, match=r"no parameter 'plant\.mas'"):
        parameter_file({'node': (SPECS, {'plant.mas': 1.0})})


def test_a_problem_takes_a_files_document() -> None:
    document = yaml.safe_load((SOURCE / 'config' / 'robots.yaml').read_text())
    assert RobotFormation.from_parameters(document) == RobotFormation.from_parameters({})
    with pytest.raises(InvalidProblem, match=r'no section for node'):
        RobotFormation.from_parameters({'other': {'ros__parameters': {'robots': ['a']}}})
    for slip, says in (
        (
            {'/**': {'ros__parameters': {}}, '/**/planer': {'ros__parameters': {'a': 1}}},
            'mean planner',
        ),
        ({'/**': {'ros_parameters': {'robots': ['a']}}}, r"'/\*\*' .* no 'ros__parameters' below"),
        ({'/a': {'planner': {'ros__parameters': 5}}}, "section '/a/planner' .* mapping .*, not 5"),
    ):
        with pytest.raises(InvalidProblem, match=says):
            ros_parameters(slip)
    for other in ('planner_server', 'planners', 'planner2'):  # others' nodes may be called so
        both = {f'/**/{other}': {'ros__parameters': {'a': 1}}, **document}
        assert RobotFormation.from_parameters(both) == RobotFormation()


def test_a_field_of_a_type_that_no_parameter_has_is_named():
    @dataclass(frozen=True)
    class Disc(Validated):
        centre: tuple[float, ...] = parameter((0.0, 1.0), 'centre')

    words = r"'centre' is declared as tuple\[float, \.\.\.\]: must"
    with pytest.raises(InvalidProblem, match=words):
        Disc()


def test_slips_in_a_declaration_are_told_and_a_pair_is_a_range():
    @dataclass(frozen=True)
    class Slip(Validated):
        mass: flaot = parameter(1.0, 'mass')  # noqa: F821

    assert refused(Slip) == "an annotation of Slip is no type: name 'flaot' is not defined"

    @dataclass(frozen=True)
    class Shared(Validated):
        share: float = parameter(0.5, 'share', allowed=(0.0, 1.0))

    assert Shared(share=1.0).share == 1.0
    assert refused(lambda: Shared(share=2.0)).endswith('must be a number in [0, 1]')


@settings(max_examples=100)
@given(st.one_of(FINITE, WHOLE, st.booleans(), st.text(max_size=20), st.lists(FINITE)))
def test_values_keep_type_and_value_through_yaml(value):
    text = yaml_value(value)
    assert '\n' not in text
    back = yaml.safe_load(text)
    assert back == value
    assert type(back) is type(value)
    assert '.' in text or not isinstance(value, float)  # a double to ROS as well

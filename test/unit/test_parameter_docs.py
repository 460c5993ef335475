# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from dataclasses import dataclass
import math
from typing import Any

from hypothesis import given, settings, strategies
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_docs import parameter_file, parameter_table, yaml_value
from tdm_planner.parameters import (
    group,
    parameter,
    POSITIVE,
    ros_parameters,
    specifications,
    Validated,
)
import yaml


@dataclass(frozen=True)
class Inner(Validated):
    gain: float = parameter(1e-8, 'gain of the loop', unit='N m/rad', allowed=POSITIVE)
    turns: int | None = parameter(None, 'turns')


@dataclass(frozen=True)
class Optional(Validated):
    limit: float | None = parameter(None, 'limit')


@dataclass(frozen=True)
class Outer(Validated):
    on: bool = parameter(True, 'switch')
    names: list[str] = parameter(['one', 'no'], 'names')
    zones: list[float] = parameter([], 'zones')
    inner: Inner = group(Inner)
    mode: str = parameter('a', 'the mode', choices=('a', 'b'), read_only=True)
    optional: Optional = group(Optional)


SPECS = specifications(Outer)


def read(text: str) -> dict[str, Any]:
    return ros_parameters(yaml.safe_load(text), 'node')


def test_file_holds_the_defaults_by_node():
    text = parameter_file({'node': (SPECS, {}), 'other': (SPECS, {'mode': 'b'})}, 'Title\nline')
    assert text.startswith('# Title\n# line\n/**/node:\n  ros__parameters:\n')
    assert read(text) == {
        'on': True,
        'names': ['one', 'no'],
        'inner.gain': 1e-8,
        'mode': 'a',
    }
    assert ros_parameters(yaml.safe_load(text), 'other')['mode'] == 'b'


def test_values_replace_defaults_and_are_checked():
    assert read(parameter_file({'node': (SPECS, {'inner.turns': 2})}))['inner.turns'] == 2
    with pytest.raises(InvalidProblem, match=r"'inner\.gain' = -1"):
        parameter_file({'node': (SPECS, {'inner.gain': -1})})
    with pytest.raises(KeyError, match=r"no parameter 'inner\.gian'"):
        parameter_file({'node': (SPECS, {'inner.gian': 1.0})})


def test_lines_are_short_enough_to_read() -> None:
    @dataclass(frozen=True)
    class Wordy(Validated):
        value: float = parameter(1.0, 'many words ' * 40)

    text = parameter_file({'node': (specifications(Wordy), {})})
    assert max(map(len, text.splitlines())) <= 99
    assert read(text) == {'value': 1.0}


@settings(deadline=None, max_examples=100, derandomize=True)
@given(
    strategies.one_of(
        strategies.floats(allow_nan=False, allow_infinity=False),
        strategies.integers(-(2**63), 2**63 - 1),
        strategies.booleans(),
        strategies.text(max_size=20),
        strategies.lists(strategies.floats(allow_nan=False, allow_infinity=False)),
    )
)
def test_values_keep_type_and_value_through_yaml(value: Any):
    text = yaml_value(value)
    assert '\n' not in text
    back = yaml.safe_load(text)
    assert back == value
    assert type(back) is type(value)


def test_numbers_are_doubles_to_ros_as_well():
    assert all('.' in yaml_value(value) for value in (1.0, 1e-8, 1e22, 5e300, math.pi))


def test_comments_and_tables_tell_unit_range_and_choices():
    text = parameter_file({'node': (SPECS, {})})
    assert '      # gain of the loop [N m/rad], in (0, 1e+12]\n      gain: 1.0e-08\n' in text
    assert '    # the mode: a, b\n' in text
    assert '      # turns:\n' in text
    rows = parameter_table(SPECS).splitlines()
    assert len(rows) == 2 + len(SPECS)
    assert rows[2 + list(SPECS).index('inner.gain')] == (
        '| `inner.gain` | `1.0e-08` | a number in (0, 1e+12] N m/rad | gain of the loop |'
    )
    assert rows[2 + list(SPECS).index('inner.turns')].startswith('| `inner.turns` | unset |')
    assert 'the mode (fixed while the node runs)' in parameter_table(SPECS)

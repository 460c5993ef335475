# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import ast
from collections.abc import Sequence
import math
import os
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import (
    Parameter,
    parameter_dict_from_yaml_file,
    parameter_value_to_python,
)
from ros_harness import NodeProcess, Ros
from std_srvs.srv import Trigger
from tdm_planner.nodes.ros_parameters import descriptor
from tdm_planner.parameters import ParameterSpec, Range
import yaml

DEFAULTS = {
    'mass': 1.0,
    'count': 3,
    'turns': None,
    'kind': 'fast',
    'names': ['a', 'b'],
    'weights': [],
    'switch': False,
    'fixed': 'here',
}


def start(
    ros: Ros,
    name: str,
    parameters: dict[str, Any] | None = None,
    arguments: Sequence[str] = (),
) -> NodeProcess:
    path = os.pathsep.join([str(Path(__file__).parent), ros.environment['PYTHONPATH']])
    return ros.start(
        'example_node',
        parameters,
        arguments=['-r', f'__node:={name}', *arguments],
        environment={'PYTHONPATH': path},
    )


def values(ros: Ros, name: str) -> tuple[dict[str, Any], dict[str, str]]:
    found = ast.literal_eval(ros.call(f'{name}/values', Trigger).message)
    assert isinstance(found, tuple)
    return found


@pytest.fixture(scope='module')
def example(ros: Ros) -> str:
    start(ros, 'example')
    return 'example'


def test_defaults_are_declared(ros: Ros, example: str) -> None:
    assert values(ros, example) == (DEFAULTS, {})


@pytest.mark.parametrize(
    ('name', 'value', 'stored'),
    [
        ('mass', 2.5, 2.5),
        ('mass', 2, 2.0),
        ('count', 8, 8),
        ('turns', -1, -1),
        ('turns', None, None),
        ('kind', 'slow', 'slow'),
        ('names', ['c'], ['c']),
        ('names', [], []),
        ('weights', [1, 2], [1.0, 2.0]),
        ('weights', [0.5], [0.5]),
        ('switch', True, True),
        # As `ros2 param set` and `load` hand over what is no number, list or null in YAML 1.1.
        ('mass', '1e-8', 1e-8),
        ('mass', '1e-08', 1e-8),
        ('mass', '2', 2.0),
        ('count', '8', 8),
        ('turns', '-1', -1),
        *[('turns', text, None) for text in ('null', '~', 'None', '')],
        ('weights', ['1e-8', '2e-8'], [1e-8, 2e-8]),
        ('weights', '[1e-8, 2, 0.5]', [1e-8, 2.0, 0.5]),
        ('switch', 'True', True),
        ('fixed', 'here', 'here'),
    ],
)
def test_allowed_values_are_taken(
    ros: Ros, example: str, name: str, value: Any, stored: Any
) -> None:
    assert ros.set_parameter_mapping(example, {name: value}) == ['']
    now = values(ros, example)[0][name]
    assert now == stored
    assert type(now) is type(stored)
    assert ros.set_parameter_mapping(example, {name: DEFAULTS[name]}) == ['']


@pytest.mark.parametrize(
    ('name', 'value', 'says'),
    [
        ('mass', 0.0, "parameter 'mass' = 0.0 is not allowed: must be a number in (0, 1e+12] kg"),
        ('mass', -1, "parameter 'mass' = -1 is not allowed: must be a number in (0, 1e+12] kg"),
        ('mass', math.nan, "parameter 'mass' = nan is not"),
        ('mass', math.inf, "parameter 'mass' = inf is not"),
        ('mass', 'heavy', "parameter 'mass' = 'heavy' is not"),
        ('mass', True, "parameter 'mass' = True is not"),
        ('mass', 'null', "parameter 'mass' = 'null' is not"),
        ('mass', '[1.0', "parameter 'mass' = '[1.0' is not"),
        ('switch', 1, "parameter 'switch' = 1 is not allowed: must be true or false"),
        ('mass', None, "parameter 'mass' = None is not"),
        ('mass', 1000.0, 'a mass above 100 kg cannot be fast'),
        ('count', 0, 'must be an integer in (0, 8]'),
        ('count', 2.5, 'must be an integer in (0, 8]'),
        ('kind', 'quick', "parameter 'kind' = 'quick' is not allowed: must be one of fast, slow"),
        ('names', 'a', 'must be a list of strings'),
        ('weights', [1.0, -1.0], 'must be a list of numbers in (0, 1e+12]'),
        (
            'fixed',
            'there',
            "parameter 'fixed' = there is not allowed: it is fixed while the node runs",
        ),
        ('mas', 1.0, "parameter 'mas' is unknown: did you mean mass?"),
        ('zzz', 1.0, "parameter 'zzz' is unknown: it is not declared here"),
    ],
)
def test_other_values_are_refused_with_a_sentence(
    ros: Ros, example: str, name: str, value: Any, says: str
) -> None:
    (reason,) = ros.set_parameter_mapping(example, {name: value})
    assert says in reason
    assert values(ros, example)[0] == DEFAULTS


def test_all_or_none_are_set_atomically(ros: Ros, example: str) -> None:
    def request(**changes: Any) -> Any:
        items = [Parameter(k, value=v).to_parameter_msg() for k, v in changes.items()]
        made = SetParametersAtomically.Request(parameters=items)
        return ros.call(f'{example}/set_parameters_atomically', SetParametersAtomically, made)

    assert not request(mass=2.0, count=-1).result.successful
    assert values(ros, example)[0] == DEFAULTS
    assert request(mass=200.0, kind='slow', turns=1).result.successful
    assert values(ros, example)[0] == {**DEFAULTS, 'mass': 200.0, 'kind': 'slow', 'turns': 1}
    assert request(mass=1, kind='fast', turns=None).result.successful
    assert values(ros, example)[0] == DEFAULTS


def test_parameters_describe_themselves(ros: Ros, example: str) -> None:
    request = DescribeParameters.Request(names=['mass', 'count', 'turns', 'kind', 'fixed'])
    answer = ros.call(f'{example}/describe_parameters', DescribeParameters, request)
    mass, count, turns, kind, fixed = answer.descriptors
    assert mass.description == 'mass of the thing [kg]'
    assert (mass.floating_point_range[0].from_value, mass.floating_point_range[0].to_value) == (
        0.0,
        1e12,
    )
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 8)
    assert turns.additional_constraints == 'must be an integer in (-inf, inf), or unset'
    assert kind.additional_constraints == 'must be one of fast, slow'
    assert fixed.read_only


def test_values_given_at_the_start(ros: Ros) -> None:
    given = {'mass': 2, 'turns': 3, 'names': [], 'weights': [1, 2], 'fixed': 'there'}
    process = start(ros, 'given', given)
    taken = {**DEFAULTS, **given, 'mass': 2.0, 'weights': [1.0, 2.0]}
    assert values(ros, 'given') == (taken, {})
    process.end_cleanly()


def test_text_given_at_the_start_is_taken_for_what_it_says(ros: Ros) -> None:
    given = {'mass': '1e-8', 'count': '"8"', 'turns': 'null', 'weights': '"[1e-8, 2]"'}
    process = start(ros, 'text', given)
    taken = {**DEFAULTS, 'mass': 1e-8, 'count': 8, 'weights': [1e-8, 2.0]}
    assert values(ros, 'text') == (taken, {})
    process.end_cleanly()


def test_what_ros2_param_dump_writes_is_taken_back_by_load_and_at_the_start(
    ros: Ros, tmp_path: Path
) -> None:
    """Both of `ros2 param`, as rclpy has them; every parameter is in the file."""
    given = {'mass': 1e-8, 'weights': [1e-8, 2.0], 'names': [], 'switch': True, 'fixed': 'there'}
    process = start(ros, 'dumped', given)
    before = values(ros, 'dumped')
    assert before == ({**DEFAULTS, **given}, {})
    names = ros.call('dumped/list_parameters', ListParameters).result.names
    request = GetParameters.Request(names=names)
    answer = ros.call('dumped/get_parameters', GetParameters, request)
    dump = dict(zip(names, map(parameter_value_to_python, answer.values), strict=True))
    file = tmp_path / 'dump.yaml'
    file.write_text(yaml.dump({'/**': {'ros__parameters': dump}}))

    messages = parameter_dict_from_yaml_file(str(file), use_wildcard=True).values()
    loaded = ros.call(
        'dumped/set_parameters', SetParameters, SetParameters.Request(parameters=list(messages))
    )
    assert [result.reason for result in loaded.results] == [''] * len(names)
    assert values(ros, 'dumped') == before
    process.end_cleanly()

    again = start(ros, 'started', arguments=['--params-file', str(file)])
    assert values(ros, 'started') == before
    again.end_cleanly()


def test_wrong_values_given_at_the_start_keep_the_node_alive(ros: Ros) -> None:
    process = start(ros, 'wrong', {'mass': -1, 'kind': 'quick', 'mas': 3})
    now, invalid = values(ros, 'wrong')
    assert now == DEFAULTS
    assert set(invalid) == {'mass', 'kind'}
    assert invalid['mass'].startswith("parameter 'mass' = -1 is not allowed")
    assert "parameter 'mas' is unknown: did you mean mass?" in process.output
    assert ros.set_parameters('wrong', mass=1.0) == ['']
    assert set(values(ros, 'wrong')[1]) == {'kind'}
    process.end_cleanly()


def test_an_unbounded_number_has_no_range() -> None:
    spec = ParameterSpec('angle', float, 0.0, 'an angle', unit='rad')
    described = descriptor(spec)
    assert isinstance(described, ParameterDescriptor)
    assert not described.floating_point_range
    half_open = ParameterSpec('n', int, 0, 'n', range=Range(upper=4, upper_open=True))
    (allowed,) = descriptor(half_open).integer_range
    assert (allowed.from_value, allowed.to_value) == (-(2**63), 3)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Declared parameters as ROS parameters, and files of them as rcl reads them."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from unittest.mock import Mock

import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from ros_harness import ros_arguments, SOURCE
from stepped_ros import NodeHere, Stepped
from tdm_planner import parameters as declared
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.ros_parameters import descriptor, ParameterNode
from tdm_planner.parameter_files import parse_yaml, ros_parameters
from tdm_planner.parameters import parameter, ParameterSpec, POSITIVE, Range, Validated
import yaml


@dataclass(frozen=True)
class ExampleParameters(Validated):
    mass: float = parameter(1.0, 'mass of the thing', unit='kg', allowed=POSITIVE)
    count: int = parameter(3, 'how many', allowed=Range(0, 8, lower_open=True))
    order: int = parameter(5, 'of a polynomial', allowed=Range(5, 15, step=2))
    turns: int | None = parameter(None, 'turns, or unset')
    kind: str = parameter('fast', 'which', choices=('fast', 'slow'))
    names: list[str] = parameter(['a', 'b'], 'names')
    weights: list[float] = parameter([], 'weights', allowed=POSITIVE)
    switch: bool = parameter(False, 'on or off')
    fixed: str = parameter('here', 'cannot be changed', read_only=True)


class ExampleNode(ParameterNode):
    """A node with nothing but parameters."""

    def __init__(self, **options) -> None:
        super().__init__('example', declared.specifications(ExampleParameters), **options)
        self.warn_of_unknown_overrides()

    def check_values(self, values: Mapping) -> None:
        if values['mass'] > 100 and values['kind'] == 'fast':
            raise InvalidProblem('a mass above 100 kg cannot be fast')


DEFAULTS = declared.to_mapping(ExampleParameters())
OF_RCLPY = {'use_sim_time', 'start_type_description_service'}


def start(ros: Stepped, name: str, given: Mapping, *arguments: str) -> NodeHere:
    return ros.add(ExampleNode, [*ros_arguments(given), '-r', f'__node:={name}', *arguments])


@pytest.fixture(scope='module')
def example(ros: Stepped):
    node = start(ros, 'example', {}).node
    assert node.parameter_values == DEFAULTS
    return node


@pytest.mark.parametrize(
    ('name', 'value', 'stored'),
    [
        ('mass', 2, 2.0), ('count', 8, 8), ('names', [], []), ('weights', [1, 2], [1.0, 2.0]),
        ('switch', True, True), ('fixed', 'here', 'here'), ('turns', None, None),
        # As `ros2 param set` and `load` hand over what is no number, list or null in YAML 1.1.
        ('mass', '1e-8', 1e-8), ('count', '8', 8), ('weights', ['1e-8', '2e-8'], [1e-8, 2e-8]),
        ('weights', '[1e-8, 2, 0.5]', [1e-8, 2.0, 0.5]), ('switch', 'True', True),
        *[('turns', unset, None) for unset in ('null', '~', 'None', '')],
    ],
)  # fmt: skip
def test_allowed_values_are_taken(ros, example, name, value, stored):
    assert ros.set_parameters('example', {name: value}) == ['']
    now = example.parameter_values[name]
    assert now == stored
    assert type(now) is type(stored)
    assert ros.set_parameters('example', {name: DEFAULTS[name]}) == ['']


@pytest.mark.parametrize(
    ('name', 'value', 'says'),
    [
        ('mass', -1, "'mass' = -1 is not allowed: must be a number in [1e-12, 1e+12] kg"),
        *[('mass', x, f"'mass' = {x!r} is not") for x in (math.nan, True, 'null', '[1.0', None)],
        ('mass', 1000.0, 'a mass above 100 kg cannot be fast'),
        ('switch', 1, "parameter 'switch' = 1 is not allowed: must be true or false"),
        ('count', 2.5, 'must be an integer in (0, 8]'),
        ('order', 6, "'order' = 6 is not allowed: must be an integer in [5, 15] in steps of 2"),
        ('names', 'a', 'must be a list of strings'),
        ('fixed', 'there', "'fixed' = there is not allowed: it is fixed while the node runs"),
        ('mas', 1.0, "parameter 'mas' is unknown: did you mean mass?"),
        ('qos_overrides.a', None, "parameter 'qos_overrides.a' is unknown"),
    ],
)
def test_other_values_are_refused_with_a_sentence(ros, example, name, value, says):
    (reason,) = ros.set_parameters('example', {name: value})
    assert says in reason
    assert example.parameter_values == DEFAULTS


def test_all_or_none_are_set_atomically(ros, example):
    service = 'example/set_parameters_atomically'
    assert not ros.set_all(service, mass=2.0, count=-1).successful
    assert example.parameter_values == DEFAULTS
    for values in ({'mass': 200.0, 'kind': 'slow', 'turns': 1}, DEFAULTS):
        assert ros.set_all(service, **values).successful
        assert example.parameter_values == {**DEFAULTS, **values}


def test_what_breaks_down_after_values_were_set_is_logged(ros, example, monkeypatch):
    broken = Mock(side_effect=RuntimeError('of\nmass'))
    monkeypatch.setattr(example, 'values_changed', broken)
    assert ros.set_parameters('example', mass=1.0) == ['']
    assert ros.log[-1][1].endswith('parameters were set, but: RuntimeError: of mass')


def test_parameters_describe_themselves(ros, example):
    names = ['mass', 'count', 'order', 'turns', 'kind', 'fixed']
    request = DescribeParameters.Request(names=names)
    answer = ros.call('example/describe_parameters', DescribeParameters, request)
    mass, count, order, turns, kind, fixed = answer.descriptors
    assert mass.description == 'mass of the thing [kg]'
    half_open = ParameterSpec('n', int, 0, 'n', range=Range(upper=4, upper_open=True))
    ranges = mass.floating_point_range, count.integer_range, descriptor(half_open).integer_range
    ends = [(allowed.from_value, allowed.to_value) for (allowed,) in ranges]
    assert ends == [(1e-12, 1e12), (1, 8), (-(2**63), 3)]
    assert (order.integer_range[0].to_value, order.integer_range[0].step) == (15, 2)
    assert turns.additional_constraints == 'must be an integer in (-inf, inf), or unset'
    assert kind.additional_constraints == 'must be one of fast, slow'
    assert fixed.read_only
    assert not descriptor(ParameterSpec('angle', float, 0.0, 'an angle')).floating_point_range


def test_what_ros2_param_dump_writes_is_taken_back_by_load_and_at_the_start(ros, tmp_path):
    """Both of `ros2 param`, as rclpy has them; every parameter is in the file, some were texts."""
    given = {'names': [], 'switch': True, 'fixed': 'there'}
    texts = {'mass': '1e-8', 'count': '"8"', 'turns': 'null', 'weights': '"[1e-8, 2]"'}
    taken = {**given, 'mass': 1e-8, 'count': 8, 'turns': None, 'weights': [1e-8, 2.0]}
    process = start(ros, 'dumped', {**given, **texts})
    before = process.node.parameter_values
    assert before == {**DEFAULTS, **taken}
    names = ros.call('dumped/list_parameters', ListParameters).result.names
    answer = ros.call('dumped/get_parameters', GetParameters, GetParameters.Request(names=names))
    dump = dict(zip(names, map(parameter_value_to_python, answer.values), strict=True))
    file = tmp_path / 'dump.yaml'
    file.write_text(yaml.dump({'/**': {'ros__parameters': dump}}))

    messages = [*parameter_dict_from_yaml_file(str(file), use_wildcard=True).values()]
    request = SetParameters.Request(parameters=messages)
    loaded = ros.call('dumped/set_parameters', SetParameters, request)
    assert [result.reason for result in loaded.results] == [''] * len(names)
    assert process.node.parameter_values == before

    again = start(ros, 'started', {}, '--params-file', str(file))
    assert again.node.parameter_values == before


# Which sections of a file a node takes: `ros_parameters` and rcl are of one opinion.

FILES = sorted((SOURCE / 'config').rglob('*.yaml'))


def section(value: int) -> dict:
    return {'ros__parameters': {'a': {'b': value}}}


DOCUMENTS = [
    *({name: section(1)} for name in (
        'planner', '/planner', '/**/planner', '/pendulum/planner', 'pendulum/planner',
        '/other/planner', '/*/planner', '/*/*/planner', '/pendulum/*', '/pendulum/**',
        '/pendulum/planner/**', '/**/pendulum/**/planner', '/**', '**', '/*', '/**/*',
    )),
    {'/other/planner': section(1), '/pendulum/planner': section(2)},
    {'/pendulum/planner': section(1), '/**/planner': section(2)},
    {'/**/planner': section(1), '/pendulum/planner': section(2)},
    {'/pendulum': {'planner': section(1)}},
    {'/pendulum/': {'planner': section(1)}},
    {'pendulum': {'planner': section(1), 'tracker': section(2)}},
    {'/**': {'planner': section(1)}},
    {'/**': {'planner': section(1), **section(2)}},
    {'/hall': {'pendulum': {'planner': section(1)}}},
]  # fmt: skip


def taken_by_rcl(ros: Stepped, file: Path, namespace: str, *words: str) -> Mapping:
    options = {'automatically_declare_parameters_from_overrides': True,
               'start_parameter_services': False, 'enable_rosout': False, 'namespace': namespace,
               'cli_args': ['--ros-args', '--params-file', str(file), *words]}  # fmt: skip
    node = Node('planner', context=ros._context, **options)
    found = node.get_parameters_by_prefix('')
    node.destroy_node()
    return {name: item.value for name, item in found.items() if name not in OF_RCLPY}


@pytest.mark.parametrize('document', DOCUMENTS, ids=str)
def test_sections_are_matched_as_rcl_does(document, ros, tmp_path):
    file = tmp_path / 'some.yaml'
    file.write_text(yaml.safe_dump(document, sort_keys=False))
    for namespace in ('/pendulum', '/', '/hall/pendulum'):
        read = parse_yaml(file.read_text())
        taken = ros_parameters(read, 'planner', namespace, required=False)
        assert taken == taken_by_rcl(ros, file, namespace), namespace


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.stem)
def test_arguments_win_over_the_files_of_the_package(file, ros):
    """Below `/**`, where rcl puts arguments as well, the sections of nodes would win."""
    stated = ros_parameters(parse_yaml(file.read_text()), 'planner', '/lab/rig')
    assert stated == taken_by_rcl(ros, file, '/lab/rig')
    words = [word for name in stated for word in ('-p', f'{name}:=1')]
    assert taken_by_rcl(ros, file, '/lab/rig', *words) == dict.fromkeys(stated, 1)


def test_who_has_no_section_is_told_the_full_names():
    document = {'/other/planner': section(1), 'tracker': section(1)}
    for space, name in (('pendulum', '/pendulum'), ('/a/b/', '/a/b'), ('', '')):
        with pytest.raises(InvalidProblem) as refused:
            ros_parameters(document, 'planner', space)
        assert str(refused.value).endswith(f"'{name}/planner', only for /other/planner, /tracker")

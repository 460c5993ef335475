# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Parameter files and tables written from the parameters' declarations.

Whoever adds a problem gets its commented ROS 2 parameter file and its table for a README here:

    specs = MyProblem.parameter_specifications({})
    print(parameter_file({'planner': (specs, {})}))
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import textwrap
from typing import Any

from tdm_planner.parameters import ParameterSpec
import yaml

_WIDTH = 99


def parameter_file(
    nodes: Mapping[str, tuple[Mapping[str, ParameterSpec], Mapping[str, Any]]], title: str = ''
) -> str:
    """
    Return a commented ROS 2 parameter file.

    `nodes` maps a node's name to its parameters and to the values that differ from the defaults;
    the sections apply in any namespace. Optional parameters without a value stand as comments.

    Raise InvalidProblem if a value is not allowed.
    """
    lines = [f'# {line}'.rstrip() for line in title.splitlines()]
    for node, (specifications, values) in nodes.items():
        unknown = sorted(set(values) - set(specifications))
        if unknown:
            raise KeyError(f"node '{node}' has no parameter '{unknown[0]}'")
        lines += [f'/**/{node}:', '  ros__parameters:']
        lines += _lines(_nested(specifications), values, indent=4)
    return '\n'.join(lines) + '\n'


def yaml_value(value: Any) -> str:
    """
    Return `value` as YAML on one line, of the same type for PyYAML and for ROS 2.

    A number keeps its decimal point (``1.0e-08``): without it PyYAML reads a string, and ROS 2 an
    integer.
    """
    if isinstance(value, list | tuple):
        return '[' + ', '.join(yaml_value(item) for item in value) + ']'
    if isinstance(value, float):
        mantissa, exponent, power = repr(value).partition('e')
        return (mantissa if '.' in mantissa else f'{mantissa}.0') + exponent + power
    text: str = yaml.safe_dump(value, default_flow_style=True, width=1000)
    return text.removesuffix('...\n').strip()


def _nested(specifications: Mapping[str, ParameterSpec]) -> dict[str, Any]:
    """Dotted names as nested mappings, whose leaves are the specifications."""
    tree: dict[str, Any] = {}
    for name, spec in specifications.items():
        *groups, last = name.split('.')
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = spec
    return tree


def _lines(tree: Mapping[str, Any], values: Mapping[str, Any], indent: int) -> Iterator[str]:
    margin = ' ' * indent
    for key, node in tree.items():
        if not isinstance(node, ParameterSpec):
            lines = list(_lines(node, values, indent + 2))
            empty = all(line.lstrip().startswith('#') for line in lines)
            yield f'{margin}{"# " if empty else ""}{yaml_value(key)}:'
            yield from lines
            continue
        yield from _comment(node, margin)
        value = values.get(node.name, node.default)
        if value in (None, [], ()):  # ROS 2 parameter files hold neither null nor empty lists
            yield f'{margin}# {key}:'
        else:
            yield f'{margin}{yaml_value(key)}: {yaml_value(node.check(value))}'


def _comment(spec: ParameterSpec, margin: str) -> list[str]:
    text = spec.description + (f' [{spec.unit}]' if spec.unit else '')
    if spec.choices:
        text += ': ' + ', '.join(spec.choices)
    elif spec.range.bounded:
        text += f', in {spec.range}'
    return textwrap.wrap(
        text, _WIDTH, initial_indent=f'{margin}# ', subsequent_indent=f'{margin}# '
    )

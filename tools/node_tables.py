# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of the documentation: topics and services, parameters, JSON keys, Python names."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
import importlib
import inspect
from pathlib import Path
import re
from typing import Any

from tdm_planner.nodes.lifecycle import AUTOSTART
from tdm_planner.nodes.tracker import KIND
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.planner_parameters import PlannerParameters
from tdm_planner.tracking.tracked_plants import tracker_type
from tdm_sim.pendulum_plant import PendulumPlantParameters
from tdm_sim.robot_plant import RobotPlantParameters
from tools.endpoints import Endpoint, KINDS
from tools.interface_texts import JSON_KEYS, TOPICS
from tools.parameter_texts import yaml_value

Specifications = Mapping[str, ParameterSpec]

# What is promised of Python: by module, and the page of docs/api with their docstrings.
FACE: Mapping[str, tuple[str, tuple[str, ...]]] = {
    'tdm_planner.problems': (
        'problems',
        ('PendulumSwingUp', 'RobotFormation', 'DirectProblem', 'Problem', 'Solution'),
    ),
    'tdm_planner.direct_method': ('problems', ('Formulation', 'Output', 'Integrated', 'Duration')),
    'tdm_planner.parameters': ('problems', ('parameter', 'group', 'Range', 'Validated')),
    'tdm_planner.drawing': ('problems', ('Line', 'Disc', 'Box')),
    'tdm_planner.trajectory': ('results', ('Trajectory',)),
    'tdm_planner.verification': ('results', ('Verification',)),
    'tdm_planner.plan_files': ('results', ('load_plan', 'save_plan')),
    'tdm_planner.client': ('results', ('PlanClient', 'PlanResult')),
    'tdm_planner.exceptions': (
        'results',
        (
            'TdmError',
            'InvalidProblem',
            'Infeasible',
            'DeadlineExceeded',
            'VerificationFailed',
            'NoState',
            'Busy',
            'Inactive',
            'PlannerFault',
            'NoAnswer',
        ),
    ),
    'tdm_sim.study': ('studies', ('run', 'ClosedLoop')),
}


def tracker_specifications(kind: str) -> dict[str, ParameterSpec]:
    """Return every parameter of the tracker of a kind of plant, by dotted name."""
    own = specifications(tracker_type(kind).parameters)
    return {KIND.name: KIND, AUTOSTART.name: AUTOSTART, **own}


def parameters_by_node() -> dict[str, Specifications]:
    """Return all parameters of every node as declared, by the node's name and plant."""
    request = specifications(PlannerParameters)
    return {
        'planner pendulum': {**request, **PendulumSwingUp.parameter_specifications({})},
        'planner robots': {**request, **RobotFormation.parameter_specifications({})},
        'tracker pendulum': tracker_specifications('pendulum'),
        'tracker robot': tracker_specifications('robot'),
        'pendulum_plant': specifications(PendulumPlantParameters),
        'robot_plant': specifications(RobotPlantParameters),
    }


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return rows of cells as a Markdown table."""
    lines = (titles, ['---'] * len(titles), *rows)
    escaped = ([cell.replace('|', '\\|') for cell in cells] for cells in lines)
    return ''.join(f'| {" | ".join(cells)} |\n' for cells in escaped)


def topic_table(node: str, endpoints: Iterable[Endpoint]) -> str:
    """Return the topics and services of a node as a table."""
    rows = []
    for end in sorted(endpoints, key=lambda end: (KINDS.index(end.kind), end.name)):
        text = TOPICS[node, end.name] + ('; latched' if end.latched else '')
        rows.append((f'`{end.name}`', end.kind, f'`{end.type_name}`', text))
    return table(('name', 'kind', 'type', 'what it is'), rows)


def merged_robots(specs: Specifications) -> dict[str, list[ParameterSpec]]:
    """Return parameters by name, those that every robot has under `<robot>`, in order."""
    merged: dict[str, list[ParameterSpec]] = {}
    for name, spec in specs.items():
        merged.setdefault(re.sub(r'\brobot\d+\b', '<robot>', name), []).append(spec)
    return merged


def robot_parameter_table(specs: Specifications) -> str:
    """
    Return the parameters as a table with one row for what every robot has.

    Defaults that differ from robot to robot stand side by side.
    """
    rows = []
    for name, (spec, *others) in merged_robots(specs).items():
        values = [one.default for one in (spec, *others)]
        defaults = dict.fromkeys('unset' if v is None else f'`{yaml_value(v)}`' for v in values)
        text = spec.description + (' (fixed while the node runs)' if spec.read_only else '')
        if name != spec.name:
            text = text.replace('robot1', '`<robot>`')
        rows.append((f'`{name}`', ', '.join(defaults), spec.allowed, text))
    return table(('parameter', 'default', 'allowed', 'what it is'), rows)


def parameter_names(nodes: Mapping[str, Specifications]) -> str:
    """Return every parameter of all nodes: those of a group in one row, for each set of nodes."""
    where: dict[str, list[str]] = {}
    for node, specs in nodes.items():
        for name in merged_robots(specs):
            where.setdefault(name, []).append(node)
    groups: dict[tuple[str, str], list[str]] = {}
    for name, those in sorted(where.items()):
        group = name.rpartition('.')[0]
        groups.setdefault((group, ', '.join(those)), []).append(f'`{name}`')
    rows = ((', '.join(names), those) for (_, those), names in groups.items())
    return table(('parameters', 'nodes'), rows)


def key_table(keys: Iterable[str]) -> str:
    """Return dotted JSON keys as a table."""
    rows = ((f'`{key.replace("*", "<name>")}`', JSON_KEYS[key]) for key in keys)
    return table(('key', 'what it is'), rows)


def python_modules() -> str:
    """Return a table of the names that are promised, linked to the pages that tell of them."""
    rows = (
        (f'[{module}](api/{page}.md)', ', '.join(f'`{name}`' for name in names))
        for module, (page, names) in FACE.items()
    )
    return table(('module', 'names'), rows)


def python_names(page: str) -> str:
    """Return a table of the names that a page of docs/api tells of, and their docstrings."""
    rows, sections = [], []
    for module, (where, names) in FACE.items():
        if where != page:
            continue
        found = importlib.import_module(module)
        sections += ['', f'## {module}', '```{eval-rst}', f'.. automodule:: {module}']
        for name in names:
            value, full = getattr(found, name), f'{module}.{name}'
            rows.append((f'`{full}`', first_sentence(value)))
            if inspect.isclass(value):
                sections += ['', f'.. autoclass:: {full}', '   :members:', '   :show-inheritance:']
            else:
                sections += ['', f'.. autofunction:: {full}']
        sections.append('```')
    return table(('name', 'what it is'), rows) + '\n'.join(sections) + '\n'


def first_sentence(value: Any) -> str:
    """Return the first line of a docstring, fit for a table."""
    text = (inspect.getdoc(value) or '').partition('\n')[0]
    return re.sub(r'`+([^`]+)`+', r'`\1`', text)


def declared_arguments(file: Path) -> dict[str, tuple[ast.expr, ast.expr]]:
    """Return default and description of the arguments of a launch file, the common ones too."""
    declared = {}
    for path in (file, file.parents[1] / 'tdm_planner' / 'launching.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ('argument', 'switch'):
                name, default, description = node.args[:3]
                if isinstance(name, ast.Constant):  # `switch` itself declares an argument
                    declared[str(name.value)] = default, description
    return declared


def launch_arguments(file: Path) -> str:
    """Return the arguments of a launch file as a table, read from the sources."""
    rows = []
    for name, (default, description) in declared_arguments(file).items():
        shown = ast.unparse(default)
        if isinstance(default, ast.Constant):
            shown = str(default.value)
        shown = re.sub(r"^str\(config_file\('(.*)'\)\)$", r'config/\1', shown)
        shown = f'`{shown}`' if shown else ''
        rows.append((f'`{name}`', shown, ast.literal_eval(description)))
    return table(('argument', 'default', 'what it is'), rows)

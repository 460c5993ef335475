# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The documentation's generated parts: what stands between markers in its pages.

A page says ``<!-- generated: NAME -->``, then comes what `fragment` returns for the name, then
``<!-- end -->``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
import json
from pathlib import Path
import re
from typing import Any

from tdm_planner.exceptions import ERRORS, Failure, InvalidProblem
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.plan_reports import plan_answer, plan_summary
from tdm_planner.starting import NODES
from tools.endpoints import endpoints, SET_UPS
from tools.interface_texts import EXECUTABLES, JSON_KEYS, TOPICS
from tools.node_tables import (
    key_table,
    launch_arguments,
    parameter_names,
    parameters_by_node,
    python_modules,
    python_names,
    robot_parameter_table,
    table,
    topic_table,
)

ROOT = Path(__file__).resolve().parents[1]

_MARKED = re.compile(r'(<!-- generated: (.+?) -->\n).*?(<!-- end -->)', re.DOTALL)
# Keys below these are names of states, limits, robots or parameters.
_OPEN = (
    'cost_terms',
    'states',
    'controls',
    'units',
    'rates',
    'robots',
    'parameters',
    'vehicles.*.units',
    'vehicles.*.joints',
    'verification.terminal_error',
    'verification.worst',
    'verification.worst_times',
    'verification.units',
)


def documentation(folder: Path) -> dict[Path, str]:
    """
    Return path and content of every generated or partly generated file of the documentation.

    Raise SystemExit if a text has nothing to describe, or something public has no text.
    """
    check_texts()
    found = {}
    for path in sorted(folder.rglob('*.md')):
        text = path.read_text(encoding='utf-8')
        if '_build' not in path.parts and _MARKED.search(text):
            found[path] = filled(text)
    return found


def filled(text: str) -> str:
    """Return a page with what stands between its markers brought up to date."""
    return _MARKED.sub(lambda match: match[1] + fragment(match[2]) + match[3], text)


def fragment(name: str) -> str:
    """Return a generated part of a page by its name, such as ``topics tracker robot``."""
    kind, _, which = name.partition(' ')
    made: dict[str, Callable[[], str]] = {
        'topics': lambda: topic_table(which.split()[0], endpoints(which)),
        'parameters': lambda: robot_parameter_table(parameters_by_node()[which]),
        'launch': lambda: launch_arguments(ROOT / 'launch' / which),
        'python': lambda: python_names(which) if which else python_modules(),
        'json': lambda: key_table(json_keys()[which]),
        'executables': lambda: executables('nodes/'),
        'executables-here': executables,
        'all-topics': all_topics,
        'all-parameters': lambda: parameter_names(parameters_by_node()),
        'codes': lambda: ', '.join(f'`{error.code}`' for error in ERRORS) + '\n',
        'json-keys': all_json_keys,
    }
    return made[kind]()


def executables(folder: str = '') -> str:
    """Return the executables as a table, linked to their pages in `folder`."""
    rows = ((f'[{name}]({folder}{name}.md)', text) for name, text in EXECUTABLES.items())
    return table(('executable', 'what it does'), rows)


def all_topics() -> str:
    """Return every topic and service of all nodes: name, type, and who gives and takes it."""
    found: dict[tuple[str, str], dict[str, dict[str, None]]] = {}
    for name in SET_UPS:
        for end in endpoints(name):
            bare = end.name.removeprefix('<robot>/')
            sides = found.setdefault((bare, end.type_name), {'gives': {}, 'takes': {}})
            side = 'gives' if end.kind in ('publishes', 'service') else 'takes'
            sides[side][name.split()[0]] = None
    rows = (
        (f'`{topic}`', f'`{type_name}`', ', '.join(sides['gives']), ', '.join(sides['takes']))
        for (topic, type_name), sides in sorted(found.items())
    )
    return table(('name', 'type', 'published or served by', 'taken or called by'), rows)


def all_json_keys() -> str:
    """Return the keys of all documents as one table."""
    found: dict[str, list[str]] = {}
    for where, keys in zip(
        ('answer', 'failure', 'summary', 'file'), json_keys().values(), strict=True
    ):
        for key in keys:
            found.setdefault(key.replace('*', '<name>'), [JSON_KEYS[key]]).append(where)
    rows = ((f'`{key}`', ', '.join(where), text) for key, (text, *where) in found.items())
    return table(('key', 'in', 'what it is'), rows)


@cache
def json_keys() -> dict[str, tuple[str, ...]]:
    """Return the dotted keys of every document, by a sentence that says where it is found."""
    single = PendulumSwingUp.from_parameters({'limits.torque': 0.09})
    several = RobotFormation.from_parameters({})
    plans = [
        TimedPlan(problem, problem.solve(deadline=30.0), 1.0) for problem in (single, several)
    ]
    documents: dict[str, list[Any]] = {
        'Answer of the service `plan`, a plan': [json.loads(plan_answer(plans[0], 1))],
        'Answer of the service `plan`, no plan': [
            json.loads(Failure.of(InvalidProblem('a sentence')).to_json())
        ],
        'Topic `plan_summary`': [json.loads(plan_summary(plan, 1, 1)) for plan in plans],
        'Plan files (`tdm plan -o plan.json`)': [
            plan_document(plan.problem, plan.solution) for plan in plans
        ],
    }
    return {
        where: tuple(dict.fromkeys(key for item in items for key in _keys(item)))
        for where, items in documents.items()
    }


def _keys(document: Mapping[str, Any], prefix: str = '') -> Iterator[str]:
    for key, value in document.items():
        name = f'{prefix}{key}'
        if prefix == 'vehicles.':
            name = 'vehicles.*'
        if name in _OPEN:
            yield f'{name}.*'
        elif isinstance(value, Mapping):
            yield from _keys(value, f'{name}.')
        else:
            yield name


def check_texts() -> None:
    """Stop where texts and public names differ."""
    named = {(name.split()[0], end.name) for name in SET_UPS for end in endpoints(name)}
    keys = {key for found in json_keys().values() for key in found}
    compared: tuple[tuple[str, set[Any], set[Any]], ...] = (
        ('topic or service', set(TOPICS), named),
        ('JSON key', set(JSON_KEYS), keys),
        ('executable', set(EXECUTABLES), {*NODES, 'tdm'}),
    )
    for what, described, there in compared:
        for item in sorted(map(str, described ^ there)):
            raise SystemExit(f'tools/interface_texts.py and the code differ: {what} {item}')

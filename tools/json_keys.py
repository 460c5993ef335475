# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The keys of every JSON document, taken from documents that the code writes for real plans."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
import json
from types import MappingProxyType
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.answers import plan_answer, plan_summary
from tdm_planner.nodes.planning import Failure
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.replanning import ActivePlan

# Keys below these are names of states, limits, robots or parameters.
OPEN = (
    'cost_terms',
    'states',
    'controls',
    'units',
    'robots',
    'parameters',
    'vehicles.*.units',
    'vehicles.*.joints',
    'verification.terminal_error',
    'verification.worst',
    'verification.worst_times',
    'verification.units',
)


@lru_cache(maxsize=1)
def json_keys() -> Mapping[str, tuple[str, ...]]:
    """Return the dotted keys of every document, by a sentence that says where it is found."""
    single = PendulumSwingUp.from_parameters({'limits.torque': 0.09})
    several = RobotFormation.from_parameters({})
    plans = [
        ActivePlan(problem, problem.solve(deadline=30.0), 1.0) for problem in (single, several)
    ]
    documents: dict[str, list[Any]] = {
        'Answer of the service `plan`, a plan': [
            json.loads(plan_answer(plans[0], 1, ['a sentence'])),
        ],
        'Answer of the service `plan`, no plan': [
            json.loads(Failure.of(InvalidProblem('a sentence')).to_json())
        ],
        'Topic `plan_summary`': [json.loads(plan_summary(plan, 1, 1)) for plan in plans],
        'Plan files (`tdm plan -o plan.json`)': [
            plan_document(plan.problem, plan.solution) for plan in plans
        ],
    }
    return MappingProxyType(
        {
            where: tuple(dict.fromkeys(key for item in items for key in _keys(item)))
            for where, items in documents.items()
        }
    )


def _keys(document: Mapping[str, Any], prefix: str = '') -> Iterator[str]:
    for key, value in document.items():
        name = f'{prefix}{key}'
        if prefix == 'vehicles.':
            name = 'vehicles.*'
        if name in OPEN:
            yield f'{name}.*'
        elif isinstance(value, Mapping):
            yield from _keys(value, f'{name}.')
        else:
            yield name

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which adapter serves a problem: that of its nearest base class, else the generic one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

from rclpy.node import Node
from tdm_planner.nodes.adapters.base import Adapter
from tdm_planner.problems.base import Problem

# By name, so that an adapter and its messages are imported only when they are needed.
ADAPTERS: Mapping[str, str] = MappingProxyType(
    {
        'tdm_planner.problems.pendulum_swing_up:PendulumSwingUp': (
            'tdm_planner.nodes.adapters.pendulum:PendulumAdapter'
        ),
        'tdm_planner.problems.robot_formation:RobotFormation': (
            'tdm_planner.nodes.adapters.formation:FormationAdapter'
        ),
        'tdm_planner.problems.base:Problem': 'tdm_planner.nodes.adapters.generic:GenericAdapter',
    }
)


def adapter_class(
    problem_class: type[Problem],
) -> Callable[[Node, Mapping[str, Any]], Adapter]:
    """Return what makes the adapter for a class of problems, from a node and its parameters."""
    bases = (f'{base.__module__}:{base.__qualname__}' for base in problem_class.__mro__)
    address = next(ADAPTERS[base] for base in bases if base in ADAPTERS)
    module, _, name = address.partition(':')
    found: Callable[[Node, Mapping[str, Any]], Adapter] = getattr(import_module(module), name)
    return found

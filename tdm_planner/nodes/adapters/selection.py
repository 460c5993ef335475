# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Which adapter serves a problem: that of its nearest base class, else the generic one."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

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


def adapter_class(problem_class: type[Problem]) -> type[Adapter]:
    """Return the adapter for a class of problems."""
    bases = (f'{base.__module__}:{base.__qualname__}' for base in problem_class.__mro__)
    address = next(ADAPTERS[base] for base in bases if base in ADAPTERS)
    module, _, name = address.partition(':')
    found: type[Adapter] = getattr(import_module(module), name)
    return found

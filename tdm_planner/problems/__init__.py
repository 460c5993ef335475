# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Problems: optimal control problems cast in the direct method.

Names are imported when they are first used: launch files read declared parameters in the system's
Python, which has neither numba nor a QP solver.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

from tdm_planner.starting import require_packages

if TYPE_CHECKING:
    from tdm_planner.plants.floating_robot import RobotLimits
    from tdm_planner.plants.rotary_pendulum import PendulumLimits
    from tdm_planner.problems.direct.problem import DirectProblem, DirectSolverParameters
    from tdm_planner.problems.formation.parameters import RobotStart
    from tdm_planner.problems.formation.problem import RobotFormation
    from tdm_planner.problems.pendulum.problem import PendulumGoal, PendulumSwingUp
    from tdm_planner.problems.pendulum.task import PendulumStart
    from tdm_planner.problems.planner_parameters import SolverParameters
    from tdm_planner.problems.problem import Problem
    from tdm_planner.problems.solution import Solution

__all__ = [
    'DirectProblem',
    'DirectSolverParameters',
    'PendulumGoal',
    'PendulumLimits',
    'PendulumStart',
    'PendulumSwingUp',
    'Problem',
    'RobotFormation',
    'RobotLimits',
    'RobotStart',
    'Solution',
    'SolverParameters',
]

_MODULES = {
    'tdm_planner.plants.floating_robot': ('RobotLimits',),
    'tdm_planner.plants.rotary_pendulum': ('PendulumLimits',),
    'tdm_planner.problems.problem': ('Problem',),
    'tdm_planner.problems.direct.problem': ('DirectProblem', 'DirectSolverParameters'),
    'tdm_planner.problems.formation.parameters': ('RobotStart',),
    'tdm_planner.problems.pendulum.problem': ('PendulumGoal', 'PendulumSwingUp'),
    'tdm_planner.problems.pendulum.task': ('PendulumStart',),
    'tdm_planner.problems.planner_parameters': ('SolverParameters',),
    'tdm_planner.problems.formation.problem': ('RobotFormation',),
    'tdm_planner.problems.solution': ('Solution',),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            require_packages()
            found = globals()[name] = getattr(import_module(module), name)
            return found
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')

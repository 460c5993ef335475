# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Problems: optimal control problems cast in the direct method."""

from tdm_planner.plants import PendulumLimits, RobotLimits
from tdm_planner.problems.base import Problem, Solution, SolverParameters
from tdm_planner.problems.direct_problem import DirectProblem, DirectSolverParameters
from tdm_planner.problems.formation_parameters import RobotStart
from tdm_planner.problems.pendulum_swing_up import (
    PendulumGoal,
    PendulumStart,
    PendulumSwingUp,
)
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.problems.search import Plan, Search

__all__ = [
    'DirectProblem',
    'DirectSolverParameters',
    'PendulumGoal',
    'PendulumLimits',
    'PendulumStart',
    'PendulumSwingUp',
    'Plan',
    'Problem',
    'RobotFormation',
    'RobotLimits',
    'RobotStart',
    'Search',
    'Solution',
    'SolverParameters',
]

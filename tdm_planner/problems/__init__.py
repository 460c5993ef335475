# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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

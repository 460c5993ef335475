# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Receding-horizon replanning: new plans while the plant moves, handed over without a jump.

No ROS, no clock: instants are seconds of one clock, which the caller reads.
"""

from tdm_planner.replanning.execution import (
    ActivePlan,
    decide,
    Execution,
    Mode,
    Observation,
    Outlook,
)
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.generic_execution import GenericExecution
from tdm_planner.replanning.replanner import Replanner, Review
from tdm_planner.replanning.swing_up_execution import SwingUpExecution

__all__ = [
    'ActivePlan',
    'Execution',
    'FormationExecution',
    'GenericExecution',
    'Mode',
    'Observation',
    'Outlook',
    'Replanner',
    'Review',
    'SwingUpExecution',
    'decide',
]

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plants as a planner knows them, reports on plans, and replanning on the way without a jump.

No ROS, no clock: instants are seconds of one clock, which the caller reads.
"""

from tdm_planner.replanning.execution import (
    ActivePlan,
    Execution,
    GenericExecution,
    Observation,
    Outlook,
)
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.replanner import ActivePlans, Replanner, Review
from tdm_planner.replanning.swing_up_execution import SwingUpExecution

__all__ = [
    'ActivePlan',
    'ActivePlans',
    'Execution',
    'FormationExecution',
    'GenericExecution',
    'Observation',
    'Outlook',
    'Replanner',
    'Review',
    'SwingUpExecution',
]

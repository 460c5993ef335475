# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Feedback laws that keep a plant on its plan and hold it at the goal; no ROS."""

from tdm_planner.tracking.linear_quadratic import (
    discrete_regulator,
    discretise,
    Regulator,
    time_varying_regulator,
    TimeVaryingRegulator,
)
from tdm_planner.tracking.motion import Action, Command, Phase, TrajectoryRejected
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.tracking.tracker_parameters import RobotTrackerParameters, TrackerParameters

__all__ = [
    'Action',
    'Command',
    'PendulumTracker',
    'PendulumTrackerParameters',
    'Phase',
    'Regulator',
    'RobotTracker',
    'RobotTrackerParameters',
    'TimeVaryingRegulator',
    'TrackerParameters',
    'TrajectoryRejected',
    'TrajectoryTracker',
    'discrete_regulator',
    'discretise',
    'time_varying_regulator',
]

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Feedback laws that keep a plant on its plan and hold it at the goal; no ROS."""

from tdm_planner.tracking.motion import Action, Command, Phase, TrajectoryRejected
from tdm_planner.tracking.pendulum_tracking import PendulumTracker
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.tracking.tracker_parameters import (
    PendulumTrackerParameters,
    RobotTrackerParameters,
    TrackerParameters,
)

__all__ = [
    'Action',
    'Command',
    'PendulumTracker',
    'PendulumTrackerParameters',
    'Phase',
    'RobotTracker',
    'RobotTrackerParameters',
    'TrackerParameters',
    'TrajectoryRejected',
    'TrajectoryTracker',
]

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Feedback laws that keep a plant on its plan and hold it at the goal; no ROS."""

from tdm_planner.tracking.motion import (
    Action,
    Command,
    Mode,
    Phase,
    TrackerParameters,
    TrajectoryRejected,
)
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker

__all__ = [
    'Action',
    'Command',
    'Mode',
    'PendulumTracker',
    'PendulumTrackerParameters',
    'Phase',
    'RobotTracker',
    'RobotTrackerParameters',
    'TrackerParameters',
    'TrajectoryRejected',
    'TrajectoryTracker',
]

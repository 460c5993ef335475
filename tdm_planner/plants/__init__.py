# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plants: equations of motion in time, vectorised, with units and derivatives."""

from tdm_planner.plants.base import Plant
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.plants.rotary_pendulum import (
    PendulumInertia,
    PendulumLimits,
    RotaryPendulum,
)

__all__ = [
    'FloatingRobot',
    'PendulumInertia',
    'PendulumLimits',
    'Plant',
    'RobotLimits',
    'RotaryPendulum',
]

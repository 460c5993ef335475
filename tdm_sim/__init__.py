# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated plants, demos, recordings, reports and studies."""

import tdm_planner  # noqa: F401  first: see tdm_planner.starting
from tdm_sim.simulation import (
    mismatched,
    mismatched_gains,
    pendulum_push,
    PlantSetup,
    robot_push,
    SimulatedPlant,
)
from tdm_sim.wheeled_robot import Walls, WheeledRobot

__all__ = [
    'PlantSetup',
    'SimulatedPlant',
    'Walls',
    'WheeledRobot',
    'mismatched',
    'mismatched_gains',
    'pendulum_push',
    'robot_push',
]

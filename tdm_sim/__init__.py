# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated plants for tests, experiments and demonstrations, and the recorder of their topics."""

import tdm_planner  # noqa: F401  first: see tdm_planner.starting
from tdm_sim.disturbances import Disturbances, pendulum_push, robot_push
from tdm_sim.integrator import integrate, runge_kutta_step
from tdm_sim.mismatch import mismatched, mismatched_gains
from tdm_sim.simulation import PlantSetup, SimulatedPlant
from tdm_sim.wheeled_robot import Walls, WheeledRobot

__all__ = [
    'Disturbances',
    'PlantSetup',
    'SimulatedPlant',
    'Walls',
    'WheeledRobot',
    'integrate',
    'mismatched',
    'mismatched_gains',
    'pendulum_push',
    'robot_push',
    'runge_kutta_step',
]

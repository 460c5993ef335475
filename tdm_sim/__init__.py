# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Simulated plants, demos, recordings, reports and studies."""

import tdm_planner  # noqa: F401  first: see tdm_planner.starting
from tdm_sim.simulation import (
    Disturbances,
    mismatched,
    mismatched_gains,
    pendulum_push,
    PlantSetup,
    robot_push,
    SimulatedPlant,
)
from tdm_sim.wheeled_robot import Walls, WheeledRobot

__all__ = [
    'Disturbances',
    'PlantSetup',
    'SimulatedPlant',
    'Walls',
    'WheeledRobot',
    'mismatched',
    'mismatched_gains',
    'pendulum_push',
    'robot_push',
]

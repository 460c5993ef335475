# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The parameters of every node, as declared."""

from __future__ import annotations

from collections.abc import Mapping

from tdm_planner.nodes.tracker import tracker_specifications
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.request import RequestParameters
from tdm_sim.pendulum_plant import PendulumPlantParameters
from tdm_sim.robot_plant import RobotPlantParameters

Specifications = Mapping[str, ParameterSpec]


def pendulum_planner() -> Specifications:
    """Return the parameters of the planner for the pendulum."""
    return {
        **specifications(RequestParameters),
        **PendulumSwingUp.parameter_specifications({}),
    }


def robots_planner() -> Specifications:
    """Return the parameters of the planner for the robots."""
    return {
        **specifications(RequestParameters),
        **RobotFormation.parameter_specifications({}),
    }


def robot_plant() -> Specifications:
    """Return the parameters of a robot's plant that do not differ from robot to robot."""
    own = ('initial.', 'robot_name')
    found = specifications(RobotPlantParameters)
    return {name: spec for name, spec in found.items() if not name.startswith(own)}


def robot_tracker() -> Specifications:
    """Return the parameters of a robot's tracker."""
    return tracker_specifications('robot')


def parameters_by_node() -> dict[str, Specifications]:
    """Return all parameters of every node, by the node's name and plant."""
    return {
        'planner pendulum': pendulum_planner(),
        'planner robots': robots_planner(),
        'tracker pendulum': tracker_specifications('pendulum'),
        'tracker robot': tracker_specifications('robot'),
        'pendulum_plant': specifications(PendulumPlantParameters),
        'robot_plant': specifications(RobotPlantParameters),
    }

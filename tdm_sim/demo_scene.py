# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What a demo is made of: its nodes, what it listens to, when it is over, how it is judged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from tdm_sim.connections import Connections
from tdm_sim.demo_speed import speed_settings
from tdm_sim.verdict import Verdict

NodeCommand = tuple[str, str, list[str]]

_FIGURES = ('duration', 'cost', 'penalty', 'solve_time', 'evaluations')


class Scene(ABC):
    """
    A plant, or several, with planner and tracker(s), seen from outside over ROS topics.

    `parameters` are the planner's, by dotted name; `file` is the parameter file of all nodes.
    """

    namespace: str
    longest: float = 40.0
    rates: float = 1.0  # see `speed_settings`

    def __init__(self, parameters: Mapping[str, Any], file: Path) -> None:
        self.parameters = dict(parameters)
        self.file = file
        self.speed = 1.0  # of simulated time
        self.answer: dict[str, Any] = {}
        self.connections = Connections()

    def command(
        self, name: str, module: str, namespace: str, drives_clock: bool = False
    ) -> NodeCommand:
        """
        Return the command of a node in a namespace, with the scene's parameter file.

        One plant drives the clock where the scene's speed is not that of real time.
        """
        arguments = ['--ros-args', '-r', f'__ns:={namespace}', '--params-file', str(self.file)]
        executable = module.rsplit('.', 1)[-1]
        settings = speed_settings(
            executable,
            self.file,
            self.speed,
            drives_clock,
            self.rates,
            self.followers,
            namespace,
        )
        for key, value in settings.items():
            arguments += ['-p', f'{key}:={json.dumps(value)}']
        return name, module, arguments

    @abstractmethod
    def nodes(self) -> list[NodeCommand]:
        """Name, module and arguments of every node to start."""

    @property
    def followers(self) -> tuple[str, ...]:
        """Topics of what simulated time waits for: commands, and states of all plants."""
        own = [f'{plant}/joint_command' for plant in self.plants]
        return (*own, *(f'{plant}/joint_states' for plant in self.plants[1:]))

    @property
    @abstractmethod
    def plants(self) -> tuple[str, ...]:
        """Namespace of every plant."""

    @abstractmethod
    def clear(self) -> None:
        """Forget what was measured and planned: another mission begins."""

    @abstractmethod
    def listen(self, node: Node) -> None:
        """Subscribe to everything that is judged, and to what the nodes say of themselves."""
        self.connections.listen(node)

    def missing(self, client: Client) -> list[str]:
        """
        Name what is not up, or has not found the others; `client` is of the planner's service.

        Whoever asks earlier has a plan that some node receives when its motion is over.
        """
        return self.unconnected() + ([] if client.service_is_ready() else ['planner'])

    @abstractmethod
    def unconnected(self) -> list[str]:
        """Name the plants that are not heard or not driven, and the trackers that hear nobody."""

    def answered(self, answer: Mapping[str, Any]) -> None:
        """Keep the planner's answer to the request."""
        self.answer = dict(answer)

    def figures(self, problem: str) -> dict[str, Any]:
        """Return what a plan file tells of the planner's answer."""
        return {'problem': problem, **{name: self.answer[name] for name in _FIGURES}}

    @property
    @abstractmethod
    def planned(self) -> bool:
        """Whether the plan has been received."""

    @property
    @abstractmethod
    def over(self) -> bool:
        """Whether there is nothing more to wait for."""

    @abstractmethod
    def status(self) -> str:
        """Return the live line."""

    @abstractmethod
    def judge(self) -> Verdict:
        """Judge what was measured."""

    @abstractmethod
    def plan(self) -> dict[str, Any]:
        """Return the plan as published, checked again, for the JSON file."""

    @abstractmethod
    def draw(self, path: Path) -> None:
        """Write the picture of plan and measurement."""

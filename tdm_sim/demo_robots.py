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

"""The robots' demo: into a formation without collision, one plant and tracker for every robot."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
import math
from pathlib import Path
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from tdm_planner.formation_plot import FormationView, plot_formation
from tdm_planner.measured_robot import MeasuredRobot
from tdm_planner.nodes.messages import joint_indices, LATCHED, seconds_of
from tdm_planner.nodes.reading import read_odometry, read_plan
from tdm_planner.nodes.robot_nodes import robot_nodes
from tdm_planner.plan_files import finite
from tdm_planner.plan_margins import plan_margins
from tdm_planner.plant_kind import ROBOT
from tdm_planner.problems.formation_verification import verify_formation
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.trajectory import Trajectory
from tdm_sim.demo_scene import NodeCommand, Scene
from tdm_sim.verdict import HOLD_TIME, Verdict
from tdm_sim.verdict_formation import (
    judge_formation,
    LONGEST_SETTLING,
    place_errors,
    POSITION_TOLERANCE,
    YAW_TOLERANCE,
)
from trajectory_msgs.msg import JointTrajectory

Array = NDArray[np.float64]

_MODULES = {
    'planner': 'tdm_planner.nodes.planner',
    'tracker': 'tdm_planner.nodes.tracker',
    'robot_plant': 'tdm_sim.robot_plant',
}


_POSE = ROBOT.state_names[:6]


class _Robot:
    """What is heard of one robot."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.clear()

    def clear(self) -> None:
        """Forget everything heard."""
        self.poses: list[list[float]] = []
        self.actuators: list[list[float]] = []
        self.motion: JointTrajectory | None = None
        self.plan: Trajectory | None = None
        self.in_place_since = math.inf

    def measured(self, start: float) -> MeasuredRobot:
        """Return what was measured from half a second before the motion."""
        poses = np.array(self.poses)
        poses = poses[poses[:, 0] > start - 0.5]
        columns = dict(zip(_POSE, poses[:, 1:].T, strict=True))
        actuators = np.array(self.actuators)
        for k, name in enumerate(('thrust', 'thruster_rate', 'torque'), start=1):
            columns[name] = np.interp(poses[:, 0], actuators[:, 0], actuators[:, k])
        return MeasuredRobot(poses[:, 0] - start, columns)


class RobotsScene(Scene):
    """One planner, and a plant and a tracker for every robot, below the namespace `robots`."""

    namespace = '/robots'
    longest = 50.0

    def __init__(self, parameters: Mapping[str, Any], file: Path) -> None:
        super().__init__(parameters, file)
        self.problem = RobotFormation.from_parameters(self.parameters)
        task = self.problem.task
        self.goals = {
            name: np.array([*task.goal[k], task.goal_yaw[k]]) for k, name in enumerate(task.names)
        }
        self.view = FormationView.of(self.problem)
        self.robots = {name: _Robot(name) for name in task.names}

    def clear(self) -> None:
        """Forget what was measured and planned: another mission begins."""
        for robot in self.robots.values():
            robot.clear()

    @property
    def plants(self) -> tuple[str, ...]:
        """Every robot's namespace."""
        return tuple(f'{self.namespace}/{name}' for name in self.robots)

    def nodes(self) -> list[NodeCommand]:
        """Plants, trackers, planner."""
        commands: list[NodeCommand] = []
        first = next(iter(self.robots))
        for node in robot_nodes({'/**/planner': {'ros__parameters': self.parameters}}):
            space = f'{self.namespace}/{node.robot}' if node.robot else self.namespace
            name = f'{node.executable}_{node.robot}' if node.robot else node.executable
            drives_clock = node.executable == 'robot_plant' and node.robot == first
            command = self.command(name, _MODULES[node.executable], space, drives_clock)
            for key, value in node.parameters.items():
                command[2].extend(['-p', f'{key}:={value}'])
            commands.append(command)
        return sorted(commands, key=lambda command: command[0] == 'planner')

    def listen(self, node: Node) -> None:
        """Subscribe to state and plan of every robot."""
        super().listen(node)
        for name, robot in self.robots.items():
            node.create_subscription(
                Odometry,
                f'{name}/odom',
                partial(self._moved, robot),
                qos_profile_sensor_data,
            )
            node.create_subscription(
                JointState,
                f'{name}/joint_states',
                partial(self._acted, robot),
                qos_profile_sensor_data,
            )
            node.create_subscription(
                JointTrajectory, f'{name}/trajectory', partial(self._planned, robot), LATCHED
            )

    def _moved(self, robot: _Robot, message: Odometry) -> None:
        at = seconds_of(message.header.stamp)
        state = read_odometry(ROBOT, message)
        robot.poses.append([at, *(state[name] for name in _POSE)])
        here = MeasuredRobot(
            np.array([at]),
            dict(zip(('x', 'y', 'u', 'v', 'yaw'), np.array(robot.poses[-1][1:6])[:, None],
                     strict=True)),
        )  # fmt: skip
        distance, turn = place_errors(here, self.goals[robot.name])
        if not (distance[0] < POSITION_TOLERANCE and turn[0] < YAW_TOLERANCE):
            robot.in_place_since = math.inf
        elif math.isinf(robot.in_place_since):
            robot.in_place_since = at

    def _acted(self, robot: _Robot, message: JointState) -> None:
        thruster, wheel = joint_indices(message.name, [joint.name for joint in ROBOT.actuated])
        robot.actuators.append(
            [
                seconds_of(message.header.stamp),
                message.effort[thruster],
                message.velocity[thruster],
                message.effort[wheel],
            ]
        )

    def _planned(self, robot: _Robot, motion: JointTrajectory) -> None:
        robot.motion, robot.plan = motion, read_plan(ROBOT, motion)

    @property
    def starts_at(self) -> float:
        """Instant [s] at which the motion starts."""
        motions = [robot.motion for robot in self.robots.values() if robot.motion is not None]
        return seconds_of(motions[0].header.stamp) if motions else math.inf

    def _silent_plants(self) -> list[str]:
        return [n for n, robot in self.robots.items() if not (robot.poses and robot.actuators)]

    def unconnected(self) -> list[str]:
        """Name every plant and tracker that is not up and connected."""
        silent, found = self._silent_plants(), []
        for name in self.robots:
            space = f'{self.namespace}/{name}'
            if name in silent or not self.connections.plant(f'{space}/robot_plant'):
                found.append(f'robot_plant of {name}')
            if not self.connections.tracker(f'{space}/tracker'):
                found.append(f'tracker of {name}')
        return found

    @property
    def planned(self) -> bool:
        """Whether every robot's plan has been received."""
        return all(robot.plan is not None for robot in self.robots.values())

    @property
    def plans(self) -> dict[str, Trajectory]:
        """Every robot's plan."""
        return {name: robot.plan for name, robot in self.robots.items() if robot.plan is not None}

    @property
    def over(self) -> bool:
        """Whether all hold their places long enough, or it is too late for it."""
        if not self.planned or self._silent_plants():
            return False
        now = min(robot.poses[-1][0] for robot in self.robots.values())
        end = self.starts_at + max(plan.duration for plan in self.plans.values())
        if now > end + LONGEST_SETTLING + HOLD_TIME + 0.5:
            return True
        latest = max(robot.in_place_since for robot in self.robots.values())
        return now - max(latest, end) > HOLD_TIME + 0.2

    def status(self) -> str:
        """Return time, and distance from the goal of every robot."""
        parts = []
        for name, robot in self.robots.items():
            if robot.poses:
                x, y = robot.poses[-1][1:3]
                away = math.hypot(x - self.goals[name][0], y - self.goals[name][1])
                parts.append(f'{name} {away:5.2f} m')
        if not parts:
            return 'waiting for the plants'
        clock = ''
        if self.planned:
            now = min(robot.poses[-1][0] for robot in self.robots.values())
            clock = f't = {now - self.starts_at:+6.2f} s   '
        return clock + 'to go: ' + '   '.join(parts)

    @property
    def measured(self) -> dict[str, MeasuredRobot]:
        """Everything measured, by robot."""
        return {name: robot.measured(self.starts_at) for name, robot in self.robots.items()}

    def judge(self) -> Verdict:
        """Judge the measured motions."""
        solve_time = float(self.answer['solve_time'])
        return judge_formation(self.view, self.plans, self.goals, self.measured, solve_time)

    def plan(self) -> dict[str, Any]:
        """Return the published plans and the planner's figures, replayed and checked here."""
        head = self.figures(self.problem.name)
        weights = np.array(self.problem.weights.penalty)
        check = verify_formation(self.problem.task, self.plans, weights)
        return {
            **head,
            'robots': {
                name: {
                    **head,
                    'duration': plan.duration,
                    **plan.to_dict(),
                    'verification': check.robots[name].to_dict(),
                }
                for name, plan in self.plans.items()
            },
            'verification': check.overall.to_dict(),
            'summary': str(self.answer['summary']),
            'parameters': finite(self.problem.to_parameters()),
        }

    def draw(self, path: Path) -> None:
        """Draw arena and time histories, planned and measured."""
        margins = {name: plan_margins(self.problem, plan) for name, plan in self.plans.items()}
        figure = plot_formation(
            self.view, self.plans, self.measured, str(self.answer['summary']), margins
        )
        figure.savefig(path, dpi=100)

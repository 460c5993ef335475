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

"""The pendulum's demo: swing up from hanging, hold for five seconds."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import joint_indices, LATCHED, seconds_of
from tdm_planner.nodes.reading import read_plan, read_state
from tdm_planner.plan_files import finite
from tdm_planner.plan_margins import plan_margins
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plotting import Measurement, plot_limits, plot_trajectory
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import Trajectory
from tdm_sim.demo_scene import NodeCommand, Scene
from tdm_sim.verdict import (
    HOLD_TIME,
    judge_pendulum,
    LONGEST_CATCH,
    MeasuredPendulum,
    UPRIGHT_TOLERANCE,
    Verdict,
)
from trajectory_msgs.msg import JointTrajectory


class PendulumScene(Scene):
    """One planner, one tracker and one plant in the namespace `pendulum`."""

    namespace = '/pendulum'
    rates = 2.0

    def __init__(self, parameters: Mapping[str, Any], file: Path) -> None:
        super().__init__(parameters, file)
        self.problem = PendulumSwingUp.from_parameters(self.parameters)
        self.clear()

    def clear(self) -> None:
        """Forget what was measured and planned: another mission begins."""
        self.trajectory: Trajectory | None = None
        self.starts_at = math.inf
        self._states: list[tuple[float, ...]] = []
        self._upright_since = math.inf

    @property
    def plants(self) -> tuple[str, ...]:
        """Return the one plant's namespace."""
        return (self.namespace,)

    def nodes(self) -> list[NodeCommand]:
        """Plant, tracker, planner."""
        return [
            self.command('pendulum_plant', 'tdm_sim.pendulum_plant', self.namespace, True),
            self.command('tracker', 'tdm_planner.nodes.tracker', self.namespace),
            self.command('planner', 'tdm_planner.nodes.planner', self.namespace),
        ]

    def listen(self, node: Node) -> None:
        """Subscribe to the state and the trajectory."""
        super().listen(node)
        node.create_subscription(
            JointState, 'joint_states', self._measured, qos_profile_sensor_data
        )
        node.create_subscription(JointTrajectory, 'trajectory', self._planned, LATCHED)

    def _measured(self, message: JointState) -> None:
        at = seconds_of(message.header.stamp)
        theta, psi, *rates = read_state(PENDULUM, message).tolist()
        (disk,) = joint_indices(message.name, ['disk'])
        self._states.append((at, theta, psi, *rates, message.effort[disk]))
        if not abs(math.remainder(theta, 2 * math.pi)) < UPRIGHT_TOLERANCE:
            self._upright_since = math.inf
        elif math.isinf(self._upright_since):
            self._upright_since = at

    def _planned(self, message: JointTrajectory) -> None:
        self.trajectory = read_plan(PENDULUM, message)
        self.starts_at = seconds_of(message.header.stamp)

    def unconnected(self) -> list[str]:
        """Name plant and tracker where they are not up and connected."""
        plant, tracker = f'{self.namespace}/pendulum_plant', f'{self.namespace}/tracker'
        up = {
            'pendulum_plant': bool(self._states) and self.connections.plant(plant),
            'tracker': self.connections.tracker(tracker),
        }
        return [name for name, there in up.items() if not there]

    @property
    def planned(self) -> bool:
        """Whether the trajectory has been received."""
        return self.trajectory is not None

    @property
    def over(self) -> bool:
        """Held long enough, or too late for it."""
        if self.trajectory is None or not self._states:
            return False
        now = self._states[-1][0]
        end = self.starts_at + self.trajectory.duration
        if now > end + LONGEST_CATCH + HOLD_TIME + 0.5:
            return True
        return now - max(self._upright_since, end) > HOLD_TIME + 0.2

    def status(self) -> str:
        """Return time, angles and torque."""
        if not self._states:
            return 'waiting for the plant'
        at, theta, psi, _, _, torque = self._states[-1]
        since = at - self.starts_at if self.planned else -math.inf
        clock = f't = {since:+6.2f} s' if math.isfinite(since) else time.strftime('%X')
        return f'{clock}   theta {theta:+7.3f} rad   psi {psi:+6.3f} rad   T {torque:+8.4f} N m'

    @property
    def measured(self) -> MeasuredPendulum:
        """Everything measured, from half a second before the motion."""
        rows = np.array(self._states)
        rows = rows[rows[:, 0] > self.starts_at - 0.5]
        return MeasuredPendulum(rows[:, 0] - self.starts_at, *rows[:, 1:].T)

    def judge(self) -> Verdict:
        """Judge the measured swing-up."""
        assert self.trajectory is not None
        limits = self.problem.limits
        return judge_pendulum(
            self.trajectory,
            self.measured,
            limits.torque,
            limits.disk_angle,
            float(self.answer['solve_time']),
        )

    def plan(self) -> dict[str, Any]:
        """Return the published trajectory and the planner's figures, replayed and checked here."""
        assert self.trajectory is not None
        return {
            **self.figures(self.problem.name),
            **self.trajectory.to_dict(),
            'verification': self.problem.task.verify(self.trajectory).to_dict(),
            'summary': str(self.answer['summary']),
            'parameters': finite(self.problem.to_parameters()),
        }

    def draw(self, path: Path) -> None:
        """Draw planned and measured time histories."""
        assert self.trajectory is not None
        m = self.measured
        columns = {
            'theta': m.theta,
            'psi': m.psi,
            'theta_dot': m.theta_dot,
            'psi_dot': m.psi_dot,
            'torque': m.torque,
        }
        limits = plot_limits(self.problem)
        figure = plot_trajectory(
            self.trajectory,
            limits,
            Measurement(m.times, columns),
            str(self.answer['summary']),
            plan_margins(self.problem, self.trajectory),
            upright='theta',
        )
        figure.savefig(path, dpi=110)

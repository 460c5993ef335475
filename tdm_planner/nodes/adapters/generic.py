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

"""Any other problem for the planner node: states and controls by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.adapters.base import Adapter
from tdm_planner.nodes.adapters.measurement import NewestMeasurement
from tdm_planner.nodes.messages import joint_indices, LATCHED, to_duration, to_stamp, WORLD_FRAME
from tdm_planner.nodes.stated_plants import StatedMessages
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import load_problem
from tdm_planner.replanning import GenericExecution, Mode, Observation
from tdm_planner.replanning.generic_execution import VEHICLE
from tdm_planner.trajectory import Trajectory
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

_START = 'start.'
_OF_THE_NODE = ('start.source', 'start.max_age', 'start.delay')


class GenericAdapter(Adapter):
    """
    Serves a problem of which only the names of states and controls are known.

    Publishes `trajectory` and `controls`, or `<vehicle>/trajectory` and `<vehicle>/controls` where
    a solution holds several, as JointTrajectory with the states' (positions) and the controls'
    (effort) names for joints. The measured state is a JointState on `joint_states` with the
    numbers X of the parameters `start.X` among its names and their values as positions; it is
    planned from as it is. A problem without such parameters has nothing to measure and is planned
    for from its parameters, whatever `start.source` says.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        super().__init__(node, values)
        self._wanted = [
            name.removeprefix(_START)
            for name, value in values.items()
            if name.startswith(_START) and name not in _OF_THE_NODE and isinstance(value, float)
        ]
        self._state = NewestMeasurement(node, JointState, 'joint_states', self._read)
        self._publishers: dict[str, Any] = {}
        self._messages: StatedMessages | None = None
        problem_class = load_problem(values['problem'])
        if issubclass(problem_class, DirectProblem):
            self._messages = StatedMessages(problem_class())
            for topic in ('trajectory', 'controls'):
                self._publisher(topic)  # from now on, for trackers to know their planner
        self._execution: GenericExecution | None = None
        self.values_changed(values)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Follow what counts as leaving a plan; topics come from the solutions."""
        self._deviation = values['replan.deviation']
        if self._execution is not None:
            self._execution.tolerance = self._deviation

    @property
    def measures(self) -> bool:
        """Whether the problem has numbers `start.X`."""
        return bool(self._wanted)

    def missing(self) -> list[str]:
        """Say where no state was received yet."""
        return [self._state.missing] if self._state.missing else []

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """Return the newest state."""
        newest = self._state.fresh(now, values['start.max_age'])
        return {_START + name: value for name, value in self._read(newest.message).items()}

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish every vehicle's states and controls."""
        several = len(solution.trajectories) > 1
        for vehicle, trajectory in solution.trajectories.items():
            prefix = f'{vehicle}/' if several else ''
            self._publish(f'{prefix}trajectory', _states(trajectory), start)
            self._publish(f'{prefix}controls', _controls(trajectory), start)

    @property
    def replans(self) -> bool:
        """Plans are reviewed on the way, where there is a state to review them by."""
        return self.measures

    def execution(self, problem: Problem) -> GenericExecution:
        """Return how plans are carried out: by a controller of which nothing is known."""
        self._execution = GenericExecution(self._wanted, self._deviation)
        return self._execution

    def observations(
        self, values: Mapping[str, Any], now: int, seconds: Callable[[int], float]
    ) -> dict[str, Observation]:
        """Return the numbers measured last."""
        newest = self._state.fresh(now, values['start.max_age'])
        numbers = np.array(list(self._read(newest.message).values()))
        return {VEHICLE: Observation(numbers, seconds(newest.instant), Mode.FOLLOWING)}

    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of the newest state."""
        return {'joint_states': self._state.age(now)}

    def _publisher(self, topic: str) -> Any:
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(JointTrajectory, topic, LATCHED)
        return self._publishers[topic]

    def _publish(self, topic: str, message: JointTrajectory, start: int) -> None:
        message.header.stamp = to_stamp(start)
        message.header.frame_id = WORLD_FRAME
        self._publisher(topic).publish(message)

    def _read(self, message: JointState) -> dict[str, float]:
        stated = self._messages
        if stated is not None and set(self._wanted) <= set(stated.states):
            values = dict(zip(stated.states, stated.read_state(message).tolist(), strict=True))
            return {name: values[name] for name in self._wanted}
        index = joint_indices(message.name, self._wanted)
        if len(message.position) != len(message.name):
            raise InvalidProblem(
                f"'position' has {len(message.position)} values for {len(message.name)} names"
            )
        found = {
            name: float(message.position[i]) for name, i in zip(self._wanted, index, strict=True)
        }
        for name, value in found.items():
            if not math.isfinite(value):
                raise InvalidProblem(f"the position of '{name}' is {value}, not a finite number")
        return found


def _states(trajectory: Trajectory) -> JointTrajectory:
    rates = np.zeros((trajectory.times.size, 0))
    if trajectory.rates is not None:
        rates = np.concatenate([trajectory.rates[:, 0], trajectory.rates[-1:, 1]])
    return JointTrajectory(
        joint_names=trajectory.state_names,
        points=[
            JointTrajectoryPoint(
                positions=state.tolist(), velocities=rate.tolist(), time_from_start=to_duration(t)
            )
            for t, state, rate in zip(
                trajectory.times.tolist(), trajectory.states, rates, strict=True
            )
        ],
    )


def _controls(trajectory: Trajectory) -> JointTrajectory:
    return JointTrajectory(
        joint_names=trajectory.control_names,
        points=[
            JointTrajectoryPoint(effort=control.tolist(), time_from_start=to_duration(t))
            for t, control in zip(trajectory.times.tolist(), trajectory.controls, strict=True)
        ],
    )

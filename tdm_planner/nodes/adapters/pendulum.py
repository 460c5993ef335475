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

"""The pendulum for the planner node: `joint_states` in, `trajectory` and markers out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from scipy.integrate import solve_ivp
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem, NoState
from tdm_planner.nodes.adapters.base import Adapter, Found
from tdm_planner.nodes.adapters.measurement import NewestMeasurement, Received
from tdm_planner.nodes.adapters.plan_in_force import PlanInForce, PlansInForce, predicted_start
from tdm_planner.nodes.adapters.stand_in import OLDEST_SHOWN, StandIn
from tdm_planner.nodes.adapters.tracker_watch import TrackerWatch
from tdm_planner.nodes.messages import (
    joint_motion,
    LATCHED,
    nanoseconds_of,
    PENDULUM_JOINTS,
    pendulum_message,
    PENDULUM_STATES,
    pendulum_trajectory,
    to_stamp,
)
from tdm_planner.nodes.pendulum_markers import PendulumPicture, plan_markers
from tdm_planner.parameters import build
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.pendulum_swing_up import PendulumSwingUp
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import Mode, Observation, SwingUpExecution
from tdm_planner.tracking.pendulum_tracking import PendulumTrackerParameters
from tdm_planner.trajectory import NANOSECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

_TRAIL = 1.0  # s
_FASTEST = 30.0  # rates that a pendulum may have, in units of its natural frequency
_FORESEEN = 2000.0  # rad of swinging at the natural frequency
_TRACKED = np.array([0.5, 0.7, 6.0, 8.0])  # deviations of a pendulum that follows its plan


class PendulumAdapter(Adapter):
    """State from the joints `pendulum` and `disk`; the plan as a JointTrajectory."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        super().__init__(node, values)
        self._trajectories = node.create_publisher(JointTrajectory, 'trajectory', LATCHED)
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self._picture = PendulumPicture(RotaryPendulum(), math.pi, _TRAIL)
        self.values_changed(values)
        self._in_force = PlansInForce()
        self._tracker = TrackerWatch(node, '', PendulumTrackerParameters)
        self.trackers[VEHICLE] = self._tracker
        self._state = NewestMeasurement(node, JointState, 'joint_states', _motion, self._moved)
        self._stand_in = StandIn(node, 'plant_markers', self._draw)

    def values_changed(self, values: Mapping[str, Any]) -> None:
        """Draw the rig as the parameters have it, unless they contradict each other."""
        with suppress(InvalidProblem):
            plant = build(RotaryPendulum, values, 'plant.')
            self._picture.set_up(plant, values['limits.disk_angle'], _TRAIL)

    def missing(self) -> list[str]:
        """Say where no state of the pendulum was received yet."""
        return [self._state.missing] if self._state.missing else []

    def measured_start(self, values: Mapping[str, Any], now: int, start: int) -> dict[str, Any]:
        """
        Propagate the newest state to the instant at which the motion starts.

        Along the plan in force while that is followed; else without torque, which is what the
        tracker applies while it waits for a plan to start.
        """
        newest = self._state.fresh(now, values['start.max_age'])
        plant = build(RotaryPendulum, values, 'plant.')
        measured = _motion(newest.message)
        fastest = float(_FASTEST * plant.natural_frequency)
        for joint, rate in zip(PENDULUM_JOINTS, measured[2:], strict=True):
            if not abs(rate) <= fastest:
                raise NoState(
                    f'the measured velocity of joint {joint} is {rate:g} rad/s: must be in '
                    f'[{-fastest:.3g}, {fastest:.3g}] rad/s to be planned from'
                )
        state = predicted_start(
            self._in_force.at(now) if self._tracker.mode(now) is Mode.FOLLOWING else None,
            measured,
            newest.instant,
            start,
            tracked=lambda away: bool((np.abs(away) < _TRACKED).all()),
            free=lambda state, wait: _coast(plant, state, wait),
            deviation=_deviation,
            carried=lambda away, _: np.zeros(4),  # the feedback takes it away
        )
        return {
            f'start.{name}': value
            for name, value in zip(PENDULUM_STATES, state.tolist(), strict=True)
        }

    def next_start(self, now: int) -> int | None:
        """Instant [ns] at which the newest published plan begins; None where it has begun."""
        return self._in_force.next_start(now)

    def publish(self, problem: Problem, solution: Solution, start: int) -> None:
        """Publish the trajectory, and draw it."""
        assert isinstance(problem, PendulumSwingUp)
        trajectory = solution.trajectory
        if trajectory.rates is None:
            trajectory = trajectory.with_rates(problem.plant.derivative)
        self._trajectories.publish(pendulum_message(trajectory, to_stamp(start)))
        now = int(self.node.get_clock().now().nanoseconds)
        self._in_force.add(PlanInForce(trajectory, start), now)
        self._markers.publish(plan_markers(problem.plant, trajectory))

    def clock_was_set(self, step: int | None) -> None:
        """Let the plans in force go on as the tracker has them go on."""
        super().clock_was_set(step)
        self._in_force.clock_was_set(step)

    def watch_plans_followed(self, found: Found) -> None:
        """Begin to listen to what the tracker says it follows."""

        def on_message(message: JointTrajectory) -> None:
            trajectories = {}
            with suppress(InvalidProblem):
                trajectories = {VEHICLE: pendulum_trajectory(message)}
            found(trajectories, nanoseconds_of(message.header.stamp))

        self.node.create_subscription(JointTrajectory, 'trajectory_in_force', on_message, LATCHED)

    def start_of(self, trajectories: Mapping[str, Trajectory]) -> dict[str, Any]:
        """Return the first state as parameters."""
        first = trajectories[VEHICLE].states[0].tolist()
        return {f'start.{key}': value for key, value in zip(PENDULUM_STATES, first, strict=True)}

    @property
    def replans(self) -> bool:
        """Plans are reviewed on the way."""
        return True

    def execution(self, problem: Problem) -> SwingUpExecution:
        """Return the tracker's feedback as a model."""
        assert isinstance(problem, PendulumSwingUp)
        return SwingUpExecution(problem, self.tracker_parameters.get(VEHICLE))

    def observations(
        self, values: Mapping[str, Any], now: int, seconds: Callable[[int], float]
    ) -> dict[str, Observation]:
        """Return the newest state of the pendulum."""
        newest = self._state.fresh(now, values['start.max_age'])
        start, mode = self._tracker.followed(now), self._tracker.mode(now)
        followed = None if start is None else seconds(start)
        stamp = seconds(newest.instant)
        return {VEHICLE: Observation(_motion(newest.message), stamp, mode, followed)}

    def ages(self, now: int) -> Mapping[str, float | None]:
        """Age of the newest state."""
        return {'joint_states': self._state.age(now)}

    def _moved(self, received: Received) -> None:
        theta, psi, *_ = _motion(received.message).tolist()
        self._picture.add(received.instant, theta, psi)

    def _draw(self) -> MarkerArray | None:
        newest, now = self._state.newest, self.node.get_clock().now()
        if newest is None or (now.nanoseconds - newest.instant) * NANOSECOND > OLDEST_SHOWN:
            return None
        theta, psi, *_ = _motion(newest.message).tolist()
        return self._picture.draw(now.to_msg(), theta, psi)


def _deviation(state: Array, reference: Array) -> Array:
    """Difference of two states (4,), theta by less than half a turn."""
    away = state - reference
    away[0] = math.remainder(float(away[0]), 2 * math.pi)
    return away


def _motion(message: JointState) -> Array:
    return joint_motion(message, PENDULUM_JOINTS)


def _coast(plant: RotaryPendulum, state: Array, duration: float) -> Array:
    """State (4,) after `duration` s without torque; a negative duration looks back."""
    longest = _FORESEEN / plant.natural_frequency
    if not abs(duration) <= longest:
        raise InvalidProblem(
            f"parameters 'start.delay' and 'start.max_age' lead from a state to a motion "
            f'{duration:.3g} s later: a swinging pendulum can be foreseen for {longest:.3g} s'
        )
    no_torque = np.zeros(1)
    result = solve_ivp(
        lambda _, x: plant.derivative(x, no_torque),
        (0.0, duration),
        state,
        method='DOP853',
        rtol=1e-9,
        atol=1e-11,
    )
    last: Array = result.y[:, -1]
    return last

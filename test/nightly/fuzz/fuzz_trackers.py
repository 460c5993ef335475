# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A tracker's life without ROS: messages, ticks and jumps of the clock in any order."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from fuzz_messages import plain
from fuzz_strategies import (
    joint_states,
    joint_trajectories,
    odometries,
    parameter_sets,
    quiet_plans,
    robot_plans,
    stamps,
)
from hypothesis import strategies as st
import numpy as np
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import (
    joint_motion,
    nanoseconds_of,
    odometry_state,
    PENDULUM_JOINTS,
    pendulum_trajectory,
    robot_trajectory,
    thruster_angle,
)
from tdm_planner.parameters import build, specifications
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.tracker import TrajectoryRefused, TrajectoryTracker

_KINDS: dict[str, Any] = {
    'pendulum': (PendulumTracker, PendulumTrackerParameters),
    'robot': (RobotTracker, RobotTrackerParameters),
}
_READING = {'pendulum': joint_states(), 'robot': st.tuples(odometries, joint_states())}
_PLAN = {'pendulum': joint_trajectories(), 'robot': robot_plans()}


@st.composite
def histories(draw: Any, plant: str) -> dict[str, Any]:
    """Parameters of a tracker and the events of its life; an instant [s] goes with every event."""
    events: list[Any] = []
    now = 100.0
    for _ in range(draw(st.integers(1, 12))):
        now += draw(st.sampled_from([0.0, 0.005, 0.005, 0.05, 1.0, -5.0, 5.0]))
        kind = draw(
            st.sampled_from(['tick', 'state', 'plan', 'good state', 'good state', 'good plan'])
        )
        if kind == 'state':
            events.append([kind, now, draw(_READING[plant])])
        elif kind == 'plan':
            start = now + draw(st.sampled_from([0.0, 0.01, 1.0, -1.0, 1e9]))
            events.append([kind, now, draw(_PLAN[plant]), start])
        elif kind == 'good plan':
            start = now + draw(st.sampled_from([0.0, 0.005, 0.05]))
            events.append(['plan', now, draw(quiet_plans(plant)), start])
        else:
            events.append([kind, now])
    chosen: dict[str, Any] = {}
    if draw(st.booleans()):
        chosen = draw(parameter_sets(specifications(_KINDS[plant][1])))
    return {'plant': plant, 'parameters': chosen, 'events': events}


def read_state(plant: str, message: Any) -> np.ndarray:
    """Read a state as the node does."""
    if plant == 'pendulum':
        return joint_motion(plain(message), PENDULUM_JOINTS)
    odometry, joints = map(plain, message)
    return np.append(odometry_state(odometry), thruster_angle(joints))


def read_plan(plant: str, message: Any) -> Any:
    """Read a plan as the node does."""
    if plant == 'pendulum':
        return pendulum_trajectory(plain(message))
    motion, controls = map(plain, message)
    return robot_trajectory(motion, controls, 'robot1')


def live_through(history: dict[str, Any]) -> str:
    """
    Live a history: only refusals are raised, every command is finite and within the limits.

    Returns the last phase.
    """
    plant = history['plant']
    made, parameters = _KINDS[plant]
    try:
        flat = {k: v for k, v in history['parameters'].items() if k in specifications(parameters)}
        tracker: TrajectoryTracker = made(build(parameters, flat))
        if plant == 'pendulum':
            tracker.prepare_hold()  # type: ignore[attr-defined]
    except InvalidProblem:
        return 'refused parameters'
    for kind, now, *rest in history['events']:
        try:
            if kind == 'state':
                tracker.observe(read_state(plant, rest[0]), now)
            elif kind == 'good state':
                tracker.observe(np.zeros(4 if plant == 'pendulum' else 7), now)
            elif kind == 'plan':
                tracker.accept(read_plan(plant, rest[0]), rest[1], now)
        except (InvalidProblem, TrajectoryRefused) as refusal:
            assert str(refusal)
            assert '\n' not in str(refusal)
        _check(tracker, tracker.command(now).control)
    return tracker.phase.value


def _check(tracker: Any, control: np.ndarray) -> None:
    limits = tracker.parameters.limits
    assert np.isfinite(control).all(), control
    if control.size == 1:
        assert abs(control[0]) <= limits.torque
    else:
        thrust, rate, torque = control
        assert 0.0 <= thrust <= limits.thrust
        assert abs(rate) <= limits.thruster_rate
        assert abs(torque) <= limits.torque


def instant_of(stamp: dict[str, int]) -> float:
    """Return the instant of a stamp [s]."""
    return nanoseconds_of(SimpleNamespace(**stamp)) * 1e-9


__all__ = ['histories', 'instant_of', 'live_through', 'read_plan', 'read_state', 'stamps']

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What the tracker node must know of each plant: its topics, its messages, its feedback law."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tdm_planner.nodes.messages import (
    joint_motion,
    LATCHED,
    PENDULUM_JOINTS,
    pendulum_trajectory,
)
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.tracker import Action, TrackerParameters, TrajectoryTracker
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

QUEUE = 10


class Intake(Protocol):
    """Where a plant's messages go; what is raised is logged as the reason for leaving one out."""

    def on_state(self, stamp: Any, read: Callable[[], Array | None]) -> None:
        """Take a state (nx,) read from a message, of the instant `stamp`; None: not complete."""

    def on_trajectory(self, stamp: Any, read: Callable[[], Trajectory | None]) -> None:
        """Take a trajectory that starts at `stamp`; None: the other half has not come yet."""


class TrackedPlant(ABC):
    """A plant as the tracker node sees it."""

    parameters: ClassVar[type[TrackerParameters]]

    @abstractmethod
    def make_tracker(self, parameters: Any) -> TrajectoryTracker:
        """Return the feedback law; raises InvalidProblem for parameters that do not fit."""

    @abstractmethod
    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to the trajectory and the state."""

    @abstractmethod
    def command_message(self, control: Array) -> JointState:
        """Return the actuator command for controls (nu,)."""

    @abstractmethod
    def error_message(self, action: Action) -> JointState:
        """Return the tracking error and the feedback within the command."""


class TrackedPendulum(TrackedPlant):
    """The rotary pendulum: `trajectory`, `joint_states` -> effort of joint `disk`."""

    parameters = PendulumTrackerParameters

    def make_tracker(self, parameters: PendulumTrackerParameters) -> TrajectoryTracker:
        """Return the pendulum's feedback law; its gains about upright are computed here."""
        tracker = PendulumTracker(parameters)
        tracker.prepare_hold()
        return tracker

    def subscribe(self, node: Node, intake: Intake) -> None:
        """Subscribe to `trajectory` and `joint_states`."""
        node.create_subscription(
            JointTrajectory,
            'trajectory',
            lambda message: intake.on_trajectory(
                message.header.stamp, lambda: pendulum_trajectory(message)
            ),
            LATCHED,
        )
        node.create_subscription(
            JointState,
            'joint_states',
            lambda message: intake.on_state(
                message.header.stamp, lambda: joint_motion(message, PENDULUM_JOINTS)
            ),
            QUEUE,
        )

    def command_message(self, control: Array) -> JointState:
        """Return the torque of the disk."""
        return JointState(name=['disk'], effort=[float(control[0])])

    def error_message(self, action: Action) -> JointState:
        """Return the errors of angles and rates, and the feedback torque."""
        return JointState(
            name=PENDULUM_JOINTS,
            position=action.error[:2].tolist(),
            velocity=action.error[2:].tolist(),
            effort=[0.0, float(action.feedback[0])],
        )

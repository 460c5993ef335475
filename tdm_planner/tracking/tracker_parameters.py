# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters that every tracker has, and those of the pendulum's and of a robot's."""

from __future__ import annotations

from dataclasses import dataclass
import math

from tdm_planner.parameters import group, parameter, POSITIVE, Range, Validated
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.plants.rotary_pendulum import PendulumLimits, RotaryPendulum

NOISE = Range(1e-9, 1e6)  # of standard deviations; their squares are computed with


@dataclass(frozen=True)
class Tolerances(Validated):
    """How far the state may be from the trajectory: an angle, unless a plant says otherwise."""

    start: float = parameter(
        0.3,
        'largest deviation at the start for a trajectory to be accepted',
        unit='rad',
        allowed=POSITIVE,
    )
    path: float = parameter(
        1.0, 'deviation from the plan at which the motion is aborted', unit='rad', allowed=POSITIVE
    )


@dataclass(frozen=True)
class ReplanOnDeviation(Validated):
    """What happens when the motion is aborted."""

    on_deviation: bool = parameter(
        False,
        'when the motion is aborted, bring the plant to rest and ask for a new plan',
    )
    interval: float = parameter(
        1.0, 'least time between two such requests', unit='s', allowed=POSITIVE
    )


@dataclass(frozen=True)
class TrackerParameters(Validated):
    """Parameters of every tracker; subclasses add the plant's own."""

    rate: float = parameter(
        200.0,
        'rate of the commands',
        unit='Hz',
        allowed=Range(1.0, 1000.0),
        read_only=True,
    )
    state_timeout: float = parameter(
        0.1,
        'age of the newest state beyond which nothing is commanded',
        unit='s',
        allowed=Range(0.0, 10.0, lower_open=True),
    )
    command_delay: float = parameter(
        0.0, 'time from sending a command to its effect', unit='s', allowed=Range(0.0, 1.0)
    )
    planner_service: str = parameter('plan', "name of the planner's service", read_only=True)
    tolerance: Tolerances = group(Tolerances)
    replan: ReplanOnDeviation = group(ReplanOnDeviation)

    @property
    def interval(self) -> float:
        """Time for which a command acts [s]."""
        return 1.0 / self.rate


@dataclass(frozen=True)
class FeedbackWeights(Validated):
    """
    Weights of the quadratic cost on dimensionless deviations.

    Angles count in rad, rates in units of the pendulum's natural frequency, torque in units of
    limits.torque.
    """

    theta: float = parameter(1.0, "weight of the pendulum's angle", allowed=POSITIVE)
    psi: float = parameter(0.1, "weight of the disk's angle", allowed=POSITIVE)
    theta_dot: float = parameter(1.0, "weight of the pendulum's rate", allowed=POSITIVE)
    psi_dot: float = parameter(0.1, "weight of the disk's rate", allowed=POSITIVE)
    torque: float = parameter(2.0, 'weight of the feedback torque', allowed=POSITIVE)


@dataclass(frozen=True)
class PendulumEstimatorParameters(Validated):
    """What the state estimator assumes."""

    angle_noise: float = parameter(
        0.0015, 'standard deviation of measured angles', unit='rad', allowed=NOISE
    )
    rate_noise: float | None = parameter(
        None,
        "standard deviation of measured rates; unset: in proportion to the rig's speed",
        unit='rad/s',
        allowed=NOISE,
    )
    model_error: float = parameter(
        0.1, "relative error of the model's accelerations", allowed=NOISE
    )


@dataclass(frozen=True)
class PendulumTrackerParameters(TrackerParameters):
    """Parameters of the pendulum's tracker."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    weights: FeedbackWeights = group(FeedbackWeights)
    estimator: PendulumEstimatorParameters = group(PendulumEstimatorParameters)


@dataclass(frozen=True)
class RobotTolerances(Tolerances):
    """How far the robot may be from the trajectory."""

    start: float = parameter(
        0.1,
        'largest distance from the start for a trajectory to be accepted',
        unit='m',
        allowed=POSITIVE,
    )
    path: float = parameter(
        0.3, 'distance from the plan at which the motion is aborted', unit='m', allowed=POSITIVE
    )


@dataclass(frozen=True)
class RobotFeedback(Validated):
    """Feedback; the gains are those of the linear-quadratic regulator of a double integrator."""

    position: float = parameter(
        0.1,
        'position error that gives full thrust; smaller is stiffer',
        unit='m',
        allowed=POSITIVE,
    )
    yaw: float = parameter(
        0.1,
        'yaw error that gives full torque; smaller is stiffer',
        unit='rad',
        allowed=POSITIVE,
    )
    deadband: float = parameter(
        0.03,
        'share of limits.thrust below which the thruster is not turned for the feedback, '
        'corrections of a coast apart',
        allowed=Range(0.0, 0.5),
    )
    coasting: float = parameter(
        0.004,
        'distance by which a coast may miss the next burn, or station-keeping the goal, before it '
        'is corrected',
        unit='m',
        allowed=POSITIVE,
    )
    misalignment: float = parameter(
        1.0,
        'angle between wanted acceleration and thruster beyond which there is no thrust',
        unit='rad',
        allowed=Range(0.0, math.pi / 2, lower_open=True),
    )


@dataclass(frozen=True)
class RobotEstimatorParameters(Validated):
    """What the state estimator assumes."""

    position_noise: float = parameter(
        0.002, 'standard deviation of x and of y', unit='m', allowed=NOISE
    )
    velocity_noise: float = parameter(
        0.002, 'standard deviation of the velocity along x and y', unit='m/s', allowed=NOISE
    )
    angle_noise: float = parameter(
        0.005,
        'standard deviation of the yaw and its rate',
        unit='rad, rad/s',
        allowed=NOISE,
    )
    thruster_noise: float = parameter(
        0.005, "standard deviation of the thruster's angle", unit='rad', allowed=NOISE
    )
    model_error: float = parameter(
        0.03, "error of the model's accelerations relative to the largest", allowed=NOISE
    )


@dataclass(frozen=True)
class RobotTrackerParameters(TrackerParameters):
    """Parameters of a robot's tracker."""

    planner_service: str = parameter(
        '/robots/plan', "name of the planner's service", read_only=True
    )
    tolerance: RobotTolerances = group(RobotTolerances)
    plant: FloatingRobot = group(FloatingRobot)
    limits: RobotLimits = group(RobotLimits)
    feedback: RobotFeedback = group(RobotFeedback)
    estimator: RobotEstimatorParameters = group(RobotEstimatorParameters)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A simulated plant without ROS: true state, saturating actuators, noisy sensors.

Plant nodes run it in real time; closed-loop experiments step it as fast as possible. Its constants
may differ from those of its controller's model (`mismatched`), and it may be disturbed.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
import math
from typing import Any, TypeVar

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import NotFinite
from tdm_planner.parameters import build, Range, specifications, to_mapping
from tdm_planner.plants.base import integrate, Plant, SIMULATION_STEP
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.plants.rotary_pendulum import mechanics, RotaryPendulum

PlantType = TypeVar('PlantType')

LONGEST_GOING_ON = 1.0  # s after a reset in which commands may be those of the motion before


def robot_actuators(limits: RobotLimits, mismatch: float, seed: int) -> dict[str, Any]:
    """
    Return `limits` and `gains` of a `PlantSetup` for a robot within its `limits`.

    Gains, delivered per commanded, are uniform in 1 +- `mismatch`, independent of the errors that
    `mismatched` draws from the seed; the thruster turns by a servo, which has no such error.
    """
    upper = np.array([limits.thrust, limits.thruster_rate, limits.torque])
    gains = 1.0 + mismatch * np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, 3) * [1, 0, 1]
    return {'limits': upper * [[0.0, -1.0, -1.0], [1.0, 1.0, 1.0]], 'gains': gains}


def pendulum_push(plant: RotaryPendulum, state: Array, impulse: float) -> Array:
    """
    State (4,) after an impulse [N m s] about the pendulum's pivot; the disk is free to react.

    The generalized momentum of theta, A theta' + B psi', jumps by `impulse`, that of psi,
    B theta' + J psi', does not.
    """
    k, (theta, _, theta_dot, psi_dot) = plant.coefficients, state
    b, j, _, _ = mechanics(k, theta, theta_dot, psi_dot)
    determinant = k.pendulum * j - b**2
    pushed: Array = state + impulse / determinant * np.array([0.0, 0.0, j, -b])
    return pushed


def robot_push(plant: FloatingRobot, state: Array, impulse: float, direction: float) -> Array:
    """
    State (nx,) after an impulse [N s] at the robot's centre of mass.

    `direction` [rad] is an angle in the arena's frame; the state begins with x, y, u, v.
    """
    pushed = state.copy()
    pushed[2:4] += impulse / plant.mass * np.array([math.cos(direction), math.sin(direction)])
    return pushed


@dataclass(frozen=True)
class WheeledRobot:
    """
    The floating robot's seven states, then angle and speed of the wheel relative to the robot.

    The wheel follows from the conservation of angular momentum; it does not act back on the
    robot's motion beyond the torque commanded.
    """

    robot: FloatingRobot

    state_names = (*FloatingRobot.state_names, 'wheel_angle', 'wheel_speed')
    state_units = (*FloatingRobot.state_units, 'rad', 'rad/s')
    control_names, control_units = FloatingRobot.control_names, FloatingRobot.control_units

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., 9), (..., 3) -> (..., 9)."""
        motion = self.robot.derivative(state[..., :7], control)
        # The wheel's speed is linear in the yaw rate, so its derivative is in omega'.
        wheel = np.stack([state[..., 8], self.robot.wheel_speed(motion[..., 5])], axis=-1)
        return np.concatenate([motion, wheel], axis=-1)


@dataclass(frozen=True, eq=False)
class PlantSetup:
    """
    Set-up of a simulated plant; arrays (nx,) or (nu,) in the plant's order and SI units.

    `initial` is the state after `reset`. Commands are clipped to `limits`, lowest and highest, and
    act multiplied by `gains`. Without a command for `command_timeout` s the controls are zero.
    `noise` holds the standard deviations of measured states. A plant that is `held` stays in its
    initial state until it is `released`, or until the first command that is not zero; after a
    reset, those that go on from before do not count, for at most `LONGEST_GOING_ON` s.
    """

    plant: Plant
    initial: Array
    limits: Array  # (2, nu)
    noise: Array
    gains: Array | float = 1.0
    command_timeout: float = 0.1
    largest_step: float = SIMULATION_STEP
    held: bool = False


class SimulatedPlant:
    """
    A plant in motion.

    `time` [s] counts the simulated time since the start. A command acts from the moment it is
    given until the next one, for at most the command time-out. `breakdowns` counts how often the
    motion became too violent to be integrated; the plant is then reset. A plant that is held is
    let go by setting `released`. What is random follows from `seed`.
    """

    def __init__(self, setup: PlantSetup, seed: int = 0) -> None:
        self.setup = setup
        self.time = 0.0
        self.timeouts = 0
        self.breakdowns = 0
        self._state = setup.initial
        self._command = np.zeros(len(setup.plant.control_names))
        self._expiry = -math.inf
        self.released = False
        self._heard_at = -math.inf  # instant of the last command, or reset
        self._goes_on_until = -math.inf  # until then, commands may be those from before a reset
        # Independent streams: draws from one must not change the other.
        streams = np.random.SeedSequence(seed).spawn(2)
        self._noise, self._direction = map(np.random.default_rng, streams)

    @property
    def state(self) -> Array:
        """Return the true state, (nx,)."""
        return self._state.copy()

    @property
    def held(self) -> bool:
        """Whether the plant is kept where it is."""
        return self.setup.held and not self.released

    @property
    def commanded(self) -> bool:
        """Whether a command acts."""
        return self.time < self._expiry

    @property
    def control(self) -> Array:
        """Return what acts now (nu,): saturated, times the gains; zero without a command."""
        if not self.commanded:
            return np.zeros_like(self._command)
        saturated: Array = np.clip(self._command, *self.setup.limits)
        return self.setup.gains * saturated

    def command(self, control: Array) -> None:
        """Give a command, (nu,); one that is not finite or of another length raises ValueError."""
        values = np.array(control, dtype=float)
        if values.shape != self._command.shape or not np.isfinite(values).all():
            raise ValueError(f'a command must be {self._command.size} finite numbers')
        self._command = values
        timeout = self.setup.command_timeout
        new = self.time >= min(self._goes_on_until, self._heard_at + timeout)
        if new or not values.any():  # what follows a zero or a silence is new
            self._goes_on_until = -math.inf
        self.released = self.released or (new and bool(values.any()))
        self._heard_at, self._expiry = self.time, self.time + timeout

    def step(self, duration: float) -> None:
        """Advance by `duration` s."""
        end = self.time + duration
        if self.time < self._expiry <= end:
            self._advance(self._expiry)
            self.timeouts += 1
        self._advance(end)

    def measure(self) -> Array:
        """State (nx,) as the sensors see it: with white Gaussian noise."""
        return self._state + self.setup.noise * self._noise.standard_normal(self._state.shape)

    def rates(self, state: Array) -> Array:
        """Rates (nx,) of a measured state under what acts now; 0 where they are no numbers."""
        if not self.held:
            with np.errstate(all='ignore'), suppress(NotFinite):
                return self.setup.plant.derivative(state, self.control)
        return np.zeros_like(state)

    def direction(self) -> float:
        """Draw an angle [rad], all directions being equally likely."""
        return float(self._direction.uniform(-math.pi, math.pi))

    def push(self, effect: Callable[[Array], Array]) -> None:
        """Change the state at once by `effect` (state before -> state after)."""
        self._state = np.array(effect(self._state), dtype=float)

    def reset(self) -> None:
        """Go back to the initial state, without a command; time and noise run on."""
        self._state = self.setup.initial
        self._expiry = -math.inf
        self.released = False
        self._heard_at, self._goes_on_until = self.time, self.time + LONGEST_GOING_ON

    def _advance(self, until: float) -> None:
        if self.held:
            self.time = until
            return
        setup, span = self.setup, until - self.time
        try:
            with np.errstate(all='ignore'):  # what is not finite is found below
                state = integrate(setup.plant, self._state, self.control, span, setup.largest_step)
        except NotFinite:  # as a stated plant says itself
            state = np.full_like(self._state, np.nan)
        self.time = until
        if np.isfinite(state).all():
            self._state = state
        else:
            self.breakdowns += 1
            self.reset()


def mismatched(plant: PlantType, mismatch: float, seed: int) -> PlantType:
    """
    Return a copy of a plant with every physical constant off by a random relative error.

    The errors are independent and uniform in +-`mismatch`; the same seed gives the same plant.
    Constants are the numbers declared as parameters of the plant's dataclass, in groups and lists,
    too. An error has the other sign where it would lead out of what is allowed for its parameter.

    Raise InvalidProblem if the disturbed constants do not make a plant (a mismatch of 1 or more
    may do that).
    """
    generator = np.random.default_rng(seed)
    constants, declared = to_mapping(plant), specifications(type(plant))

    def disturbed(value: Any, allowed: Range) -> Any:
        if isinstance(value, list):
            return [disturbed(item, allowed) for item in value]
        if not isinstance(value, float):
            return value
        error = mismatch * generator.uniform(-1.0, 1.0)
        return value * (1.0 + (error if value * (1.0 + error) in allowed else -error))

    found = {n: disturbed(value, declared[n].range) for n, value in constants.items()}
    return build(type(plant), found)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A simulated plant without ROS: true state, saturating actuators, noisy sensors.

Plant nodes run it in real time; closed-loop experiments step it as fast as possible.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants.base import integrate, LARGEST_STEP, Plant
from tdm_sim.disturbances import Disturbances

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlantSetup:
    """
    Set-up of a simulated plant; arrays (nx,) or (nu,) in the plant's order and SI units.

    `initial` is the state after `reset`. Commands are clipped to [`lower`, `upper`] and act
    multiplied by `gains` (default 1). Without a command for `command_timeout` s the controls are
    zero; `command_loss` is the probability that a command gets lost. `noise` holds the standard
    deviations of measured states. `contact`, where given, replaces the state after every step. A
    plant that is `held` stays in its initial state until its `release`, or until the first command
    that is not zero.
    """

    plant: Plant
    initial: Array
    lower: Array
    upper: Array
    noise: Array
    gains: Array | None = None
    command_timeout: float = 0.1
    command_loss: float = 0.0
    contact: Callable[[Array], Array] | None = None
    largest_step: float = LARGEST_STEP
    held: bool = False

    def __post_init__(self) -> None:
        """Check shapes and values."""
        nx, nu = len(self.plant.state_names), len(self.plant.control_names)
        sizes = {'initial': nx, 'noise': nx, 'lower': nu, 'upper': nu}
        if self.gains is not None:
            sizes['gains'] = nu
        for name, size in sizes.items():
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (size,) or not np.isfinite(values).all():
                raise InvalidProblem(f"simulation '{name}' must be {size} finite numbers")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if (self.noise < 0.0).any():
            raise InvalidProblem("simulation 'noise' must be standard deviations in [0, inf)")
        if (self.lower > self.upper).any():
            raise InvalidProblem("simulation 'lower' must not exceed 'upper'")


class SimulatedPlant:
    """
    A plant in motion.

    `time` [s] counts the simulated time since the start. A command acts from the moment it is
    given until the next one, for at most the command time-out. `breakdowns` counts how often the
    motion became too violent to be integrated; the plant is then reset.
    """

    def __init__(self, setup: PlantSetup, seed: int = 0) -> None:
        self.setup = setup
        self.time = 0.0
        self.timeouts = 0
        self.breakdowns = 0
        self._state = setup.initial
        self._command = np.zeros(len(setup.plant.control_names))
        self._expiry = -math.inf
        self._released = False
        self.disturbances = Disturbances(seed)

    @property
    def state(self) -> Array:
        """Return the true state, (nx,)."""
        return self._state.copy()

    @property
    def held(self) -> bool:
        """Whether the plant is kept where it is."""
        return self.setup.held and not self._released

    @property
    def commanded(self) -> bool:
        """Whether a command acts."""
        return self.time < self._expiry

    @property
    def control(self) -> Array:
        """Return what acts now (nu,): saturated, times the gains; zero without a command."""
        if not self.commanded:
            return np.zeros_like(self._command)
        saturated: Array = np.clip(self._command, self.setup.lower, self.setup.upper)
        return saturated if self.setup.gains is None else self.setup.gains * saturated

    def command(self, control: Array) -> None:
        """Give a command, (nu,); one that is not finite or of another length raises ValueError."""
        values = np.array(control, dtype=float)
        if values.shape != self._command.shape or not np.isfinite(values).all():
            raise ValueError(f'a command must be {self._command.size} finite numbers')
        if self.disturbances.loses_command(self.setup.command_loss):
            return
        self._command = values
        self._released = self._released or bool(values.any())
        self._expiry = self.time + self.setup.command_timeout

    def release(self) -> None:
        """Let a plant that is held go."""
        self._released = True

    def step(self, duration: float) -> None:
        """Advance by `duration` s."""
        end = self.time + duration
        if self.time < self._expiry <= end:
            self._advance(self._expiry)
            self.timeouts += 1
        self._advance(end)

    def measure(self) -> Array:
        """State (nx,) as the sensors see it."""
        return self.disturbances.measured(self._state, self.setup.noise)

    def push(self, effect: Callable[[Array], Array]) -> None:
        """Change the state at once by `effect` (state before -> state after)."""
        self._state = np.array(effect(self._state), dtype=float)

    def reset(self) -> None:
        """Go back to the initial state, without a command; time and noise run on."""
        self._state = self.setup.initial
        self._expiry = -math.inf
        self._released = False

    def _advance(self, until: float) -> None:
        if self.held:
            self.time = until
            return
        state = integrate(
            self.setup.plant,
            self._state,
            self.control,
            until - self.time,
            self.setup.largest_step,
            self.setup.contact,
        )
        self.time = until
        if np.isfinite(state).all():
            self._state = state
        else:
            self.breakdowns += 1
            self.reset()

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The interface between the plant node and a plant: parameters, drawing, pushes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.drawing import Drawn
from tdm_planner.parameters import parameter, POSITIVE, Range, SEED, Validated
from tdm_planner.plant_kind import PlantKind
from tdm_sim.simulation import PlantSetup, SimulatedPlant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimulationParameters(Validated):
    """Parameters of every simulated plant; subclasses add the plant's own."""

    rate: float = parameter(
        200.0,
        'rate of the published states',
        unit='Hz',
        allowed=Range(0.1, 1000.0),
        read_only=True,
    )
    real_time_factor: float = parameter(
        1.0,
        'speed of the simulated motion relative to the clock; with publish_clock, of that clock '
        'relative to real time',
        allowed=Range(0.0, 100.0, lower_open=True),
    )
    publish_clock: bool = parameter(
        False,
        'drive /clock, for other nodes with use_sim_time; one node alone must do so',
        read_only=True,
    )
    clock_followers: list[str] = parameter(
        ['joint_command'],
        'topics of commands or joint states whose publishers the clock waits for when they fall '
        'behind',
        read_only=True,
    )
    command_timeout: float = parameter(
        0.1,
        'simulated time without a command after which the actuators are switched off',
        unit='s',
        allowed=POSITIVE,
    )
    mismatch: float = parameter(
        0.0,
        'largest relative error put on every physical constant, at random (0.05 is 5 %)',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    mismatch_seed: int = parameter(
        0, 'seed of the mismatch: the same seed gives the same plant', allowed=SEED
    )
    seed: int = parameter(
        0,
        'seed of measurement noise, command loss and push directions',
        allowed=SEED,
        read_only=True,
    )


@dataclass(frozen=True)
class MarkerParameters(Validated):
    """How the plant is drawn while a viewer subscribes."""

    rate: float = parameter(
        25.0,
        'rate of the markers while a viewer subscribes; 0 switches them off',
        unit='Hz',
        allowed=Range(0.0, 100.0),
    )
    trail: float = parameter(
        1.0, 'time for which the travelled trail is shown', unit='s', allowed=Range(0.0, 600.0)
    )


class PlantModel(ABC):
    """
    A plant to be simulated: its joints, parameters and drawing, and what a push does to it.

    `parameters` has a group `markers`. The joints may have states that the simulation alone knows
    (the angle of a wheel).
    """

    parameters: type[SimulationParameters]
    kind: PlantKind

    @abstractmethod
    def make_setup(self, parameters: Any) -> PlantSetup:
        """Return the plant, its limits and its disturbances as `parameters` say."""

    @abstractmethod
    def push(
        self, parameters: Any, simulation: SimulatedPlant
    ) -> tuple[Callable[[Array], Array], str]:
        """Return what one push of `disturbance.impulse` does to a state, and a description."""

    @abstractmethod
    def drawn(self, parameters: Any) -> Drawn:
        """Return what the plant looks like with these parameters."""

    def name(self, parameters: Any) -> str:
        """Return the name of one of several plants, the child frame of its odometry."""
        del parameters
        return ''

    def description(self, parameters: Any) -> str:
        """Return the plant's URDF, '' if it has none."""
        del parameters
        return ''

    def observe(self, state: Array) -> None:
        """Record a true state (nx,)."""
        del state

    def conditions(self, parameters: Any) -> tuple[list[str], Mapping[str, Any]]:
        """Return warnings about what was observed, and figures for the diagnostics."""
        del parameters
        return [], {}

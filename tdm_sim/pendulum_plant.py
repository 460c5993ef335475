# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `pendulum_plant`: a simulated rotary pendulum."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import partial
import math
import sys

import numpy as np
from numpy.typing import NDArray
from tdm_planner.drawing import PendulumDrawing
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import group, parameter, Range, SIGNED, Validated
from tdm_planner.pendulum_urdf import pendulum_urdf
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plants.rotary_pendulum import PendulumLimits, RotaryPendulum
from tdm_sim.plant_node import (
    deviation,
    Disturbance,
    MarkerParameters,
    PlantModel,
    PlantNode,
    SimulationParameters,
)
from tdm_sim.simulation import mismatched, pendulum_push, PlantSetup, SimulatedPlant

Array = NDArray[np.float64]

_ANGLE, _RATE = Range(-1e6, 1e6), Range(-1e3, 1e3)


@dataclass(frozen=True)
class InitialState(Validated):
    """State at the start and after `reset`."""

    theta: float = parameter(math.pi, "pendulum's angle from upright", unit='rad', allowed=_ANGLE)
    psi: float = parameter(0.0, "disk's angle", unit='rad', allowed=_ANGLE)
    theta_dot: float = parameter(0.0, "pendulum's angular velocity", unit='rad/s', allowed=_RATE)
    psi_dot: float = parameter(0.0, "disk's angular velocity", unit='rad/s', allowed=_RATE)


@dataclass(frozen=True)
class PendulumNoise(Validated):
    """Standard deviations of the measurements (white, Gaussian)."""

    theta: float = deviation("the pendulum's angle", 'rad')
    psi: float = deviation("the disk's angle", 'rad')
    theta_dot: float = deviation("the pendulum's angular velocity", 'rad/s')
    psi_dot: float = deviation("the disk's angular velocity", 'rad/s')


@dataclass(frozen=True)
class PendulumDisturbance(Disturbance):
    """Disturbances of the pendulum."""

    impulse: float = parameter(
        1.5e-4,
        "angular impulse of one push about the pendulum's pivot",
        unit='N m s',
        allowed=SIGNED,
    )


@dataclass(frozen=True)
class PendulumPlantParameters(SimulationParameters):
    """Parameters of the node."""

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = group(PendulumLimits)
    initial: InitialState = group(InitialState)
    noise: PendulumNoise = group(PendulumNoise)
    disturbance: PendulumDisturbance = group(PendulumDisturbance)
    markers: MarkerParameters = group(MarkerParameters)


class PendulumModel(PlantModel):
    """
    A simulated rotary pendulum.

    Joints pendulum (theta, 0 upright, not wrapped) and disk (psi, and the torque applied). The
    disk has no mechanical stop.
    """

    parameters = PendulumPlantParameters
    kind = PENDULUM

    def __init__(self, node: PlantNode) -> None:
        del node

    def make_setup(self, parameters: PendulumPlantParameters) -> PlantSetup:
        """Return the pendulum, its limits and its disturbances as `parameters` say."""
        torque = np.array([parameters.limits.torque])
        return PlantSetup(
            plant=mismatched(parameters.plant, parameters.mismatch, parameters.mismatch_seed),
            initial=np.array(astuple(parameters.initial)),
            lower=-torque,
            upper=torque,
            noise=np.array(astuple(parameters.noise)),
            command_timeout=parameters.command_timeout,
            command_loss=parameters.disturbance.command_loss,
        )

    def drawn(self, parameters: PendulumPlantParameters) -> PendulumDrawing:
        """Return the rig with these parameters."""
        return PendulumDrawing(parameters.plant, parameters.limits.torque)

    def description(self, parameters: PendulumPlantParameters) -> str:
        """Return the URDF."""
        return pendulum_urdf(parameters.plant)

    def push(self, parameters: PendulumPlantParameters, simulation: SimulatedPlant) -> str:
        """Give an impulse about the pendulum's pivot."""
        impulse, plant = parameters.disturbance.impulse, simulation.setup.plant
        assert isinstance(plant, RotaryPendulum)
        simulation.push(lambda state: pendulum_push(plant, state, impulse))
        return f'pushed the pendulum with {impulse:g} N m s'


PendulumPlant = partial(PlantNode, 'pendulum_plant', PendulumModel)
main = partial(run, PendulumPlant)

if __name__ == '__main__':
    sys.exit(main())

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `pendulum_plant`: a simulated rotary pendulum."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import partial
import math
import sys

import numpy as np
from tdm_planner.drawing import PendulumDrawing
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import group, parameter, Range, SIGNED, Validated
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plants.rotary_pendulum import pendulum_urdf, PendulumLimits, RotaryPendulum
from tdm_sim.plant_node import (
    deviation,
    PlantModel,
    PlantNode,
    SimulationParameters,
)
from tdm_sim.simulation import mismatched, pendulum_push, PlantSetup, SimulatedPlant

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
class PendulumDisturbance(Validated):
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


def _setup(given: PendulumPlantParameters) -> PlantSetup:
    return PlantSetup(
        plant=mismatched(given.plant, given.mismatch, given.mismatch_seed),
        initial=np.array(astuple(given.initial)),
        limits=given.limits.torque * np.array([[-1.0], [1.0]]),
        noise=np.array(astuple(given.noise)),
    )


def _push(given: PendulumPlantParameters, simulation: SimulatedPlant, _: str) -> str:
    impulse, plant = given.disturbance.impulse, simulation.setup.plant
    assert isinstance(plant, RotaryPendulum)
    simulation.push(lambda state: pendulum_push(plant, state, impulse))
    return f'pushed the pendulum with {impulse:g} N m s'


# The disk has no mechanical stop.
PENDULUM_MODEL = PlantModel(
    PendulumPlantParameters,
    PENDULUM,
    _setup,
    _push,
    drawn=lambda given: PendulumDrawing(given.plant, given.limits.torque),
    description=lambda given: pendulum_urdf(given.plant),
)
PendulumPlant = partial(PlantNode, 'pendulum_plant', lambda _: PENDULUM_MODEL)
main = partial(run, PendulumPlant)

if __name__ == '__main__':
    sys.exit(main())

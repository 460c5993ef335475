# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `robot_plant`: one simulated floating robot with a turning thruster and reaction wheel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
import sys

import numpy as np
from tdm_planner.drawing import RobotDrawing
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import (
    group,
    NON_NEGATIVE,
    parameter,
    positive,
    Range,
    SIGNED,
    Validated,
)
from tdm_planner.plant_kind import ROBOT
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_sim.plant_node import (
    deviation,
    PlantModel,
    PlantNode,
    SimulationParameters,
)
from tdm_sim.simulation import (
    mismatched,
    PlantSetup,
    robot_actuators,
    robot_push,
    SimulatedPlant,
    WheeledRobot,
)

_PLACE, _RATE = Range(-1e4, 1e4), Range(-100.0, 100.0)


@dataclass(frozen=True)
class RobotInitialState(Validated):
    """State at the start and after `reset`."""

    x: float = parameter(2.0, 'position along x', unit='m', allowed=_PLACE)
    y: float = parameter(2.0, 'position along y', unit='m', allowed=_PLACE)
    u: float = parameter(0.0, 'velocity along x', unit='m/s', allowed=_RATE)
    v: float = parameter(0.0, 'velocity along y', unit='m/s', allowed=_RATE)
    yaw: float = parameter(0.0, 'yaw, from the x axis', unit='rad', allowed=_PLACE)
    omega: float = parameter(0.0, 'yaw rate', unit='rad/s', allowed=_RATE)
    alpha: float = parameter(
        0.0, "thruster's angle from the robot's front", unit='rad', allowed=_PLACE
    )
    wheel_speed: float = parameter(
        0.0, 'speed of the reaction wheel', unit='rad/s', allowed=Range(-1e5, 1e5)
    )


@dataclass(frozen=True)
class RobotNoise(Validated):
    """Standard deviations of the measurements (white, Gaussian)."""

    position: float = deviation('x and of y', 'm')
    velocity: float = deviation('the velocity along x and along y', 'm/s')
    yaw: float = deviation('the yaw', 'rad')
    omega: float = deviation('the yaw rate', 'rad/s')
    alpha: float = deviation("the thruster's angle", 'rad')


@dataclass(frozen=True)
class RobotDisturbance(Validated):
    """Disturbances of the robot."""

    impulse: float = parameter(
        0.3, 'impulse of one push at the centre of mass', unit='N s', allowed=SIGNED
    )
    direction: float | None = parameter(
        None,
        "direction of a push in the arena's frame; unset: at random",
        unit='rad',
        allowed=SIGNED,
    )


@dataclass(frozen=True)
class RobotArena(Validated):
    """What is drawn of the robot: its body, and the separation to be kept."""

    robot_radius: float = parameter(
        0.15, "radius of the robot's body", unit='m', allowed=NON_NEGATIVE
    )
    minimum_separation: float = positive(
        0.4, 'least distance of two robots, the diameter of the disc drawn around this one', 'm'
    )


@dataclass(frozen=True)
class RobotPlantParameters(SimulationParameters):
    """Parameters of the node."""

    robot_name: str = parameter(
        '',
        "name of the robot, the child frame of odom; empty: the last part of the node's namespace",
        read_only=True,
    )
    plant: FloatingRobot = group(FloatingRobot)
    limits: RobotLimits = group(RobotLimits)
    initial: RobotInitialState = group(RobotInitialState)
    noise: RobotNoise = group(RobotNoise)
    disturbance: RobotDisturbance = group(RobotDisturbance)
    arena: RobotArena = group(RobotArena)


def _setup(given: RobotPlantParameters) -> PlantSetup:
    off = given.mismatch, given.mismatch_seed
    start, noise, names = vars(given.initial), given.noise, WheeledRobot.state_names
    deviations = dict.fromkeys('xy', noise.position) | dict.fromkeys('uv', noise.velocity)
    deviations |= vars(noise)
    return PlantSetup(
        plant=WheeledRobot(mismatched(given.plant, *off)),
        initial=np.array([start.get(name, 0.0) for name in names]),
        noise=np.array([deviations.get(name, 0.0) for name in names]),
        **robot_actuators(given.limits, *off),
    )


def _push(given: RobotPlantParameters, simulation: SimulatedPlant, name: str) -> str:
    plant, impulse = simulation.setup.plant, given.disturbance.impulse
    assert isinstance(plant, WheeledRobot)
    direction = given.disturbance.direction
    if direction is None:
        direction = simulation.direction()
    simulation.push(lambda state: robot_push(plant.robot, state, impulse, direction))
    return f'pushed {name} with {impulse:g} N s towards {direction:.3f} rad'


def _drawn(given: RobotPlantParameters) -> RobotDrawing:
    arena = given.arena
    return RobotDrawing(arena.minimum_separation, given.limits.thrust, arena.robot_radius)


ROBOT_MODEL = PlantModel(
    RobotPlantParameters,
    ROBOT,
    _setup,
    _push,
    _drawn,
    name=lambda given, space: given.robot_name or space.rsplit('/', 1)[-1] or 'robot1',
)
RobotPlant = partial(PlantNode, 'robot_plant', lambda _: ROBOT_MODEL)
main = partial(run, RobotPlant)

if __name__ == '__main__':
    sys.exit(main())

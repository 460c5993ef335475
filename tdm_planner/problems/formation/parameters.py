# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the problem `robot_formation`, those of every robot included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
import re
from types import MappingProxyType
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import (
    group,
    NON_NEGATIVE,
    parameter,
    ParameterSpec,
    POSITIVE,
    Range,
    SIGNED,
    specifications,
    Validated,
)
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.problems.request import SolverParameters

DEFAULT_ROBOTS = ('robot1', 'robot2', 'robot3')
_DEFAULT_STARTS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {'robot1': (0.6, 0.7, 0.0), 'robot2': (3.4, 0.8, 2.4), 'robot3': (2.1, 3.4, -1.6)}
)
_DEFAULT_OFFSETS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {'robot1': (0.45, 0.0, 0.0), 'robot2': (-0.225, 0.39, 0.0), 'robot3': (-0.225, -0.39, 0.0)}
)
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')
_RESERVED = frozenset({'anchor', 'start', 'replan', 'problem', 'solver', 'plan', 'markers'})
_COORDINATE = Range(-1e4, 1e4)
_SIDE = Range(1e-6, 2e4)


@dataclass(frozen=True)
class Arena(Validated):
    """The arena [0, length] x [0, width] and the distances to be kept in it."""

    length: float = parameter(4.0, 'length along x', unit='m', allowed=_SIDE)
    width: float = parameter(4.0, 'width along y', unit='m', allowed=_SIDE)
    minimum_separation: float = parameter(
        0.4,
        'least distance between the centres of two robots (MSD); half of it is kept from walls '
        'and from the edges of keep-out zones',
        unit='m',
        allowed=POSITIVE,
    )
    tracking_margin: float = parameter(
        0.03,
        'distance added to minimum_separation when planning, for errors of the tracking; less '
        'where start or goal are nearer',
        unit='m',
        allowed=NON_NEGATIVE,
    )
    obstacles: list[float] = parameter(
        [],
        'circular keep-out zones: x, y, radius of one after the other',
        unit='m',
        allowed=_COORDINATE,
    )


@dataclass(frozen=True)
class FormationAnchor(Validated):
    """Where the formation is to be."""

    anchor: list[float] = parameter(
        [2.0, 2.0, 0.5],
        'pose x [m], y [m], yaw [rad] of the formation in the arena',
        length=3,
        allowed=_COORDINATE,
    )


@dataclass(frozen=True)
class FormationWeights(Validated):
    """Weights of the performance index (28), on raw units, and of the penalty (29)."""

    time: float = parameter(
        0.05, 'w1, of the arrival time of the first robot', unit='1/s', allowed=NON_NEGATIVE
    )
    sequence: float = parameter(
        0.05,
        'w2, of the errors of the intervals between arrivals',
        unit='1/s',
        allowed=NON_NEGATIVE,
    )
    gas: float = parameter(
        0.9,
        'w3, of the gas used by all robots, the integral of thrust per mass',
        unit='s/m',
        allowed=NON_NEGATIVE,
    )
    penalty: list[float] = parameter(
        [0.25, 0.25, 0.25, 0.25],
        'k1 to k4 of the penalty: walls and keep-out zones, thrust, torque and thruster rate, '
        'separations',
        length=4,
        allowed=NON_NEGATIVE,
    )


@dataclass(frozen=True)
class FormationSolver(SolverParameters):
    """How long and how hard to search."""

    deadline: float = parameter(
        1.0,
        'time allowed for a plan; the best verified one is returned',
        unit='s',
        allowed=POSITIVE,
    )
    tolerance: float = parameter(
        1e-6, 'largest penalty that still counts as feasible, eps of (10)', allowed=POSITIVE
    )
    starts: int = parameter(
        4,
        'initial guesses from which the minimiser starts; thrust_arcs take four times as many '
        'where robots are five or more',
        allowed=Range(1, 1000),
    )
    longest: float = parameter(
        120.0, 'latest time of arrival that is considered', unit='s', allowed=POSITIVE
    )


@dataclass(frozen=True)
class RobotStart(Validated):
    """State of one robot to start from."""

    x: float | None = parameter(None, 'position along x', unit='m', allowed=_COORDINATE)
    y: float | None = parameter(None, 'position along y', unit='m', allowed=_COORDINATE)
    yaw: float = parameter(0.0, 'yaw, from the x axis', unit='rad', allowed=_COORDINATE)
    u: float = parameter(0.0, 'velocity along x', unit='m/s', allowed=Range(-100.0, 100.0))
    v: float = parameter(0.0, 'velocity along y', unit='m/s', allowed=Range(-100.0, 100.0))
    omega: float = parameter(0.0, 'yaw rate', unit='rad/s', allowed=Range(-100.0, 100.0))
    alpha: float | None = parameter(
        None,
        "thruster's angle from the robot's front; unset: it may be turned before the start",
        unit='rad',
        allowed=_COORDINATE,
    )
    thrust: float = parameter(
        0.0,
        'thrust at the start, used where end_accelerations is given',
        unit='N',
        allowed=NON_NEGATIVE,
    )
    torque: float = parameter(0.0, 'torque at the start', unit='N m', allowed=SIGNED)
    arrived: float = parameter(
        0.0,
        'time for which a robot that stays has been at its goal: the next one keeps its interval '
        'to that arrival',
        unit='s',
        allowed=NON_NEGATIVE,
    )


@dataclass(frozen=True)
class FormationParameters(Validated):
    """Everything that does not belong to one robot."""

    robots: list[str] = parameter(
        list(DEFAULT_ROBOTS), 'names of the robots, in the order of arrival', read_only=True
    )
    plant: FloatingRobot = group(FloatingRobot)
    limits: RobotLimits = group(RobotLimits)
    arena: Arena = group(Arena)
    formation: FormationAnchor = group(FormationAnchor)
    arrival_interval: float = parameter(
        2.0,
        'wanted time between two arrivals, Delta_t of (28)',
        unit='s',
        allowed=NON_NEGATIVE,
    )
    weights: FormationWeights = group(FormationWeights)
    method: str = parameter(
        'thrust_arcs',
        'form of the motions: thrust_arcs, which burn at full thrust and coast between, as least '
        'gas wants it, or polynomials, whose thrust runs smoothly',
        choices=('thrust_arcs', 'polynomials'),
    )
    thrust_reserve: float = parameter(
        0.1,
        'share of limits.thrust that the burns of thrust_arcs leave to the feedback',
        allowed=Range(0.0, 0.9),
    )
    polynomial_order: int = parameter(
        7,
        'order of the reference polynomials of x and y: odd; 5 is what the boundary conditions '
        'need, every further two vary one more derivative at both ends',
        allowed=Range(5, 15),
    )
    yaw_order: int = parameter(
        5, 'order of the reference polynomials of the yaw: odd', allowed=Range(5, 15)
    )
    speed_factor_order: int = parameter(
        0,
        'degree of the speed factor dt/ds along the virtual arc; 0 is tau = t',
        allowed=Range(0, 6),
    )
    end_accelerations: str = parameter(
        'varied',
        'whether accelerations at start and goal are varied parameters or given boundary '
        'conditions',
        choices=('varied', 'given'),
    )
    nodes: int | None = parameter(
        None,
        'Chebyshev nodes along an arc at which limits are kept and gas is summed; unset: as many '
        'as polynomial_order needs',
        allowed=Range(9, 401),
    )
    solver: FormationSolver = group(FormationSolver)


def robot_names(names: Sequence[str]) -> tuple[str, ...]:
    """
    Check the names of the robots.

    Raises
    ------
    InvalidProblem
        If there is none, one occurs twice, or one cannot be a name of ROS.

    """
    if not names:
        raise InvalidProblem("parameter 'robots' = [] is not allowed: at least one name is needed")
    groups = {name.split('.')[0] for name in specifications(FormationParameters)}
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InvalidProblem(
                f"parameter 'robots' names '{name}' twice: every name must be different"
            )
        if not _NAME.fullmatch(name):
            raise InvalidProblem(
                f"parameter 'robots' holds {name!r}: a name must be letters, digits and '_', a "
                'letter first'
            )
        if name in groups | _RESERVED:
            raise InvalidProblem(
                f"parameter 'robots' holds '{name}', which is the name of a group of parameters"
            )
    return tuple(names)


def default_start(name: str) -> RobotStart:
    """Start of a robot that none is given for; without position unless it is a default robot."""
    if name not in _DEFAULT_STARTS:
        return RobotStart()
    x, y, yaw = _DEFAULT_STARTS[name]
    return RobotStart(x=x, y=y, yaw=yaw)


def default_offset(name: str) -> tuple[float, ...] | None:
    """Pose in the formation of a robot that none is given for."""
    return _DEFAULT_OFFSETS.get(name)


def formation_specifications(values: Mapping[str, Any]) -> dict[str, ParameterSpec]:
    """Every parameter by dotted name, for the robots named in ``values['robots']``."""
    general = specifications(FormationParameters)
    names = robot_names(general['robots'].check(values.get('robots', list(DEFAULT_ROBOTS))))
    found = dict(general)
    for name in names:
        offset = default_offset(name)
        found[f'formation.{name}'] = ParameterSpec(
            name=f'formation.{name}',
            kind=list[float],
            default=None if offset is None else list(offset),
            description=f"pose x [m], y [m], yaw [rad] of {name} in the anchor's frame",
            range=_COORDINATE,
            optional=True,
            length=3,
        )
    for name in names:
        start = default_start(name)
        for key, spec in specifications(RobotStart).items():
            found[f'{name}.start.{key}'] = replace(
                spec, name=f'{name}.start.{key}', default=getattr(start, key)
            )
    return found


def place_in_formation(anchor: Sequence[float], pose: Sequence[float]) -> list[float]:
    """Return a pose of the arena [x, y, yaw] as one in the frame of the formation's anchor."""
    x, y, yaw = pose
    across, along = x - anchor[0], y - anchor[1]
    cosine, sine = math.cos(anchor[2]), math.sin(anchor[2])
    return [
        cosine * across + sine * along,
        cosine * along - sine * across,
        math.remainder(yaw - anchor[2], 2 * math.pi),
    ]


def place_in_arena(anchor: Sequence[float], place: Sequence[float]) -> list[float]:
    """Return a place [x, y, yaw] in the frame of the formation's anchor as a pose of the arena."""
    cosine, sine = math.cos(anchor[2]), math.sin(anchor[2])
    return [
        anchor[0] + cosine * place[0] - sine * place[1],
        anchor[1] + sine * place[0] + cosine * place[1],
        anchor[2] + place[2],
    ]

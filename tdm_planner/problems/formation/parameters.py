# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the problem `robot_formation`, those of every robot included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
import math
import re
from types import MappingProxyType
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import (
    build,
    group,
    NON_NEGATIVE,
    parameter,
    ParameterSpec,
    positive,
    Range,
    SIGNED,
    specifications,
    Validated,
)
from tdm_planner.plants.floating_robot import FloatingRobot, RobotLimits
from tdm_planner.problems.planner_parameters import SolverParameters

DEFAULT_ROBOTS = ('robot1', 'robot2', 'robot3')
_DEFAULT_STARTS: Mapping[str, tuple[float | None, float | None, float]] = MappingProxyType(
    {'robot1': (0.6, 0.7, 0.0), 'robot2': (3.4, 0.8, 2.4), 'robot3': (2.1, 3.4, -1.6)}
)
DEFAULT_OFFSETS: Mapping[str, list[float]] = MappingProxyType(
    {'robot1': [0.45, 0.0, 0.0], 'robot2': [-0.225, 0.39, 0.0], 'robot3': [-0.225, -0.39, 0.0]}
)
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')
_RESERVED = frozenset({'anchor', 'start', 'replan', 'problem', 'solver', 'plan', 'markers'})
_COORDINATE = Range(-1e4, 1e4)
_SIDE = Range(1e-6, 2e4)
_ORDER = Range(5, 15, step=2)
_MOST_ROBOTS = 100
_CLEARANCE = 1.5  # of two places of robots that are added, in units of minimum_separation
_GRID = 40  # candidate places along the longer side of the arena


@dataclass(frozen=True)
class Arena(Validated):
    """The arena [0, length] x [0, width] and the distances to be kept in it."""

    length: float = parameter(4.0, 'length along x', unit='m', allowed=_SIDE)
    width: float = parameter(4.0, 'width along y', unit='m', allowed=_SIDE)
    minimum_separation: float = positive(
        0.4,
        'least distance between the centres of two robots (MSD); half of it is kept from walls '
        'and from the edges of keep-out zones',
        'm',
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
        multiple=3,
    )

    def __post_init__(self) -> None:
        """Check the values, alone and together."""
        super().__post_init__()
        for name, side in (('length', self.length), ('width', self.width)):
            if side < self.minimum_separation:
                raise InvalidProblem(
                    f"parameter 'arena.{name}' = {side:g} is not allowed: must be at least "
                    f'arena.minimum_separation = {self.minimum_separation:g} m'
                )
        for x, y, radius in self.zones:
            if radius <= 0.0:
                raise InvalidProblem(
                    f"parameter 'arena.obstacles' holds radius {radius:g} at ({x:g}, {y:g}): must "
                    'be in (0, inf) m'
                )

    @property
    def zones(self) -> Array:
        """Return x, y and radius of every keep-out zone (m, 3)."""
        return np.array(self.obstacles, dtype=float).reshape(-1, 3)


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

    deadline: float = positive(
        1.0, 'time allowed for a plan; the best verified one is returned', 's'
    )
    tolerance: float = positive(1e-6, 'largest penalty that still counts as feasible, eps of (10)')
    starts: int = parameter(
        4,
        'initial guesses from which the minimiser starts; thrust_arcs take four times as many '
        'where robots are five or more',
        allowed=Range(1, 1000),
    )
    longest: float = positive(120.0, 'latest time of arrival that is considered', 's')


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
        'time since the arrival of a robot that is at its goal already; the arrival_interval to '
        'the next one counts from then',
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
        allowed=_ORDER,
    )
    yaw_order: int = parameter(
        5, 'order of the reference polynomials of the yaw: odd', allowed=_ORDER
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

    Raise InvalidProblem if there is none, one occurs twice, or one cannot be a name of ROS.
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
    return RobotStart(*_DEFAULT_STARTS.get(name, (None, None, 0.0)))


def formation_specifications(values: Mapping[str, Any]) -> dict[str, ParameterSpec]:
    """Every parameter by dotted name, for the robots named in ``values['robots']``."""
    general = specifications(FormationParameters)
    names = robot_names(general['robots'].check(values.get('robots', list(DEFAULT_ROBOTS))))
    found = dict(general)
    for name in names:
        found[f'formation.{name}'] = replace(
            general['formation.anchor'],
            name=f'formation.{name}',
            default=DEFAULT_OFFSETS.get(name),
            description=f"pose x [m], y [m], yaw [rad] of {name} in the anchor's frame",
            optional=True,
        )
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


def with_number_of_robots(values: Mapping[str, Any], number: int) -> dict[str, Any]:
    """
    Return the parameters by dotted name that make a formation one of `number` robots.

    The first ones that `values` (by dotted name) names in `robots` take part. Where more are
    wanted, robot4, robot5, ... are added: each starts as far as possible from all others, facing
    the formation, and takes the free place in it that is nearest to the anchor.

    Raise InvalidProblem if the number is not in [1, 100], or the arena has no room for so many.
    """
    if not 1 <= number <= _MOST_ROBOTS:
        raise InvalidProblem(
            f'number_of_robots = {number} is not allowed: must be in [1, {_MOST_ROBOTS}]'
        )
    specs = formation_specifications(values)
    names = list(values.get('robots', DEFAULT_ROBOTS))[:number]
    changed: dict[str, Any] = {}
    if len(names) < number:
        numbered = (f'robot{k}' for k in count(1))
        added = [next(n for n in numbered if n not in names) for _ in range(number - len(names))]
        given = {name: spec.check(values.get(name, spec.default)) for name, spec in specs.items()}
        changed = _places(build(FormationParameters, values), given, names, added)
        names += added
    return {'robots': names, **changed}


def _places(
    formation: FormationParameters, given: Mapping[str, Any], names: list[str], added: list[str]
) -> dict[str, Any]:
    """Return starts and places in the formation of the robots that are added."""
    free, anchor = _free_points(formation.arena), formation.formation.anchor
    known = [(given[f'{name}.start.x'], given[f'{name}.start.y']) for name in names]
    starts = [np.array(place) for place in known if None not in place]
    offsets = [given[f'formation.{name}'] for name in names]
    goals = [np.array(place_in_arena(anchor, place)[:2]) for place in offsets if place is not None]
    least = _CLEARANCE * formation.arena.minimum_separation
    made: dict[str, Any] = {}
    for k, name in enumerate(added):
        room, open_points = _room(free, starts), free[_room(free, goals) >= least]
        if not len(open_points) or room.max() < least:
            raise InvalidProblem(
                f'number_of_robots = {len(names) + len(added)} is not allowed: there is room in '
                f'the arena for {len(names) + k} at the most'
            )
        starts.append(free[room.argmax()])
        goals.append(open_points[np.linalg.norm(open_points - anchor[:2], axis=1).argmin()])
        x, y = starts[-1].tolist()
        place = place_in_formation(anchor, [*goals[-1].tolist(), anchor[2]])
        made[f'{name}.start.x'], made[f'{name}.start.y'] = round(x, 6), round(y, 6)
        made[f'{name}.start.yaw'] = round(math.atan2(anchor[1] - y, anchor[0] - x), 6)
        made[f'formation.{name}'] = [round(value, 6) for value in place]
    return made


def _free_points(arena: Arena) -> Array:
    """Return points (n, 2) on which a robot keeps clear of walls and keep-out zones."""
    gap = arena.minimum_separation
    step = max(arena.length, arena.width) / _GRID
    x, y = (
        np.linspace(gap, side - gap, max(0, round((side - 2 * gap) / step) + 1))
        for side in (arena.length, arena.width)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(points[:, None] - arena.zones[:, :2], axis=2)
    return np.asarray(points[(away >= arena.zones[:, 2] + gap).all(axis=1)])


def _room(points: Array, taken: list[Array]) -> Array:
    """Return the distances (n,) of points (n, 2) from the nearest place that is taken."""
    away = np.linalg.norm(points[:, None] - np.reshape(taken, (-1, 2)), axis=2)
    return np.asarray(away.min(axis=1, initial=np.inf))

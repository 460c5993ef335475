# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plants that tracker and plant nodes know by name: built-in ones and stated problems.

Planner, tracker and plant declare a stated problem's parameters under the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass, fields, make_dataclass
from typing import Any, get_type_hints

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import shown
from tdm_planner.plant_kind import kind_of, PENDULUM, PlantKind, ROBOT
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.tracking.motion import TrackerParameters
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.tracking.stated_tracking import StatedTracker, StatedTrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker

_NODE = frozenset(('autostart', 'kind', 'problem'))  # parameters of the nodes themselves
# Of the simulated plant: a problem that has one, too, cannot be simulated.
PLANT_NODE = frozenset((
    'rate', 'real_time_factor', 'publish_clock', 'clock_followers', 'command_timeout', 'mismatch',
    'mismatch_seed', 'seed', 'held', 'disturbance', 'initial', 'noise',
))  # fmt: skip


def stated_problem(name: str) -> type[DirectProblem]:
    """
    Return the class of a stated problem, by its registered name or ``module:Class``.

    Raise InvalidProblem if there is none, or it brings its own transcription.
    """
    found = load_problem(name)
    if not issubclass(found, DirectProblem):
        raise InvalidProblem(
            f"problem '{name}' has nodes of its own: this node takes only a DirectProblem"
        )
    return found


def with_parameters_of(
    base: type[Any],
    problem: type[DirectProblem],
    besides: Sequence[str] = ('solver', 'start'),
    taken: Set[str] = frozenset(),
) -> type[Any]:
    """
    Return the dataclass of a node's parameters: those of `base`, and the problem's but `besides`.

    Raise InvalidProblem if both have one of the same name, or one is `taken`.
    """
    own = {item.name for item in fields(base)} | _NODE | taken
    kind: Any = problem
    added = [item for item in fields(kind) if item.name not in besides]
    for item in added:
        if item.name in own:
            raise InvalidProblem(
                f"parameter '{item.name}' of {problem.__name__} is one of the nodes' own: rename "
                'it, to run tracker and simulated plant'
            )
    hints = get_type_hints(problem)
    declared = [(item.name, hints[item.name], copy(item)) for item in added]
    name = f'{problem.__name__}{base.__name__}'
    return make_dataclass(name, declared, bases=(base,), frozen=True)


def problem_of(problem: type[DirectProblem], parameters: Any) -> DirectProblem:
    """Make the problem from a node's parameters, see `with_parameters_of`; others are defaults."""
    kind: Any = problem
    names = [item.name for item in fields(kind) if hasattr(parameters, item.name)]
    made: DirectProblem = kind(**{name: getattr(parameters, name) for name in names})
    return made


@dataclass(frozen=True)
class TrackerType:
    """
    What the tracker's node must know of a plant: joints, parameters, how its tracker is made.

    `make_tracker` returns the tracker for parameters of the class `parameters`; it raises
    InvalidProblem for values that contradict each other.
    """

    kind: PlantKind
    parameters: type[TrackerParameters]
    make_tracker: Callable[[Any], TrajectoryTracker]


_PENDULUM = TrackerType(PENDULUM, PendulumTrackerParameters, PendulumTracker)
_ROBOT = TrackerType(ROBOT, RobotTrackerParameters, RobotTracker)
# A problem's plant may be named by the problem, as planner and plant name it.
_BUILT_IN: Mapping[str, TrackerType] = {
    'pendulum': _PENDULUM,
    'robot': _ROBOT,
    'pendulum_swing_up': _PENDULUM,
    'robot_formation': _ROBOT,
}


def tracker_type(kind: str) -> TrackerType:
    """
    Return the plant of a kind: pendulum, robot, or the problem of that name.

    The tracker of a stated problem has the problem's parameters as well. Raise InvalidProblem if
    there is none of that name.
    """
    if kind in _BUILT_IN:
        return _BUILT_IN[kind]
    if ':' not in kind and kind not in problem_names():
        raise InvalidProblem(
            f"parameter 'kind' = '{shown(kind)}' is not allowed: must be one of pendulum, "
            'robot, or a stated problem such as my_module:MyProblem'
        )
    problem = stated_problem(kind)
    return TrackerType(
        kind_of(problem()),
        with_parameters_of(StatedTrackerParameters, problem),
        lambda parameters: StatedTracker(problem_of(problem, parameters), parameters),
    )

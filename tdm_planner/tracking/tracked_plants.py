# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plants that tracker and plant nodes know by name: built-in ones and stated problems.

Planner, tracker and plant declare a stated problem's parameters under the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
from dataclasses import dataclass
from typing import Any, get_type_hints

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import shown
from tdm_planner.plant_kind import kind_of, PENDULUM, PlantKind, ROBOT
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.tracking import TrackerParameters, TrajectoryTracker
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.tracking.stated_tracking import StatedTracker

_NODE = frozenset(('autostart', 'kind', 'problem'))  # parameters of the nodes themselves


def stated_problem(name: str) -> type[DirectProblem]:
    """
    Return the class of a stated problem, by its registered name or ``module:Class``.

    Raise InvalidProblem if there is none, or it brings its own transcription.
    """
    found = load_problem(name)
    if not issubclass(found, DirectProblem):
        raise InvalidProblem(
            f"problem '{name}' brings nodes of its own: only a DirectProblem is simulated and "
            'tracked by its statement'
        )
    return found


def with_parameters_of(
    base: type[Any], problem: type[DirectProblem], besides: Sequence[str] = ('solver', 'start')
) -> type[Any]:
    """
    Return the dataclass of a node's parameters: those of `base`, and the problem's but `besides`.

    Raise InvalidProblem if both have one of the same name.
    """
    mine = {item.name for item in dataclasses.fields(base)} | _NODE
    added: list[tuple[str, Any, Any]] = []
    kind: Any = problem
    field: Any = dataclasses.field
    hints = get_type_hints(problem)
    for item in dataclasses.fields(kind):
        if item.name in besides:
            continue
        if item.name in mine:
            raise InvalidProblem(
                f"parameter '{item.name}' of {problem.__name__} is one of the node's own: name it "
                'otherwise'
            )
        copied: Any = field(
            default=item.default, default_factory=item.default_factory, metadata=item.metadata
        )
        added.append((item.name, hints[item.name], copied))
    return dataclasses.make_dataclass(
        f'{problem.__name__}{base.__name__}', added, bases=(base,), frozen=True
    )


def problem_of(problem: type[DirectProblem], parameters: Any) -> DirectProblem:
    """Make the problem from a node's parameters, see `with_parameters_of`; others are defaults."""
    kind: Any = problem
    names = [item.name for item in dataclasses.fields(kind) if hasattr(parameters, item.name)]
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
        with_parameters_of(TrackerParameters, problem),
        lambda parameters: StatedTracker(problem_of(problem, parameters), parameters),
    )

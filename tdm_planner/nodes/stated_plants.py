# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
A stated problem's plant as messages: which names its states and controls have, and where.

States are joints by `DirectProblem.joints` (position and velocity), or named like themselves
(position); controls are named like themselves (effort). What a node needs of the problem are its
own parameters: they have the same names in the planner, the tracker and the plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import joint_indices, nanoseconds_of
from tdm_planner.parameters import LARGEST, specifications
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_planner.problems.registry import load_problem
from tdm_planner.trajectory import NANOSECOND, Trajectory

Array = NDArray[np.float64]

_NOT_OF_THE_PLANT = ('solver', 'start')


def stated_problem(name: str) -> type[DirectProblem]:
    """
    Return the class of a stated problem, by its registered name or ``module:Class``.

    Raises
    ------
    InvalidProblem
        If there is none, or it brings its own transcription.

    """
    found = load_problem(name)
    if not issubclass(found, DirectProblem):
        raise InvalidProblem(
            f"problem '{name}' brings nodes of its own: only a DirectProblem is simulated and "
            'tracked by its statement'
        )
    return found


def with_parameters_of(
    base: type[Any], problem: type[DirectProblem], besides: Sequence[str] = _NOT_OF_THE_PLANT
) -> type[Any]:
    """
    Return the dataclass of a node's parameters: those of `base`, and the problem's own.

    Raises
    ------
    InvalidProblem
        If both have one of the same name.

    """
    mine = {item.name for item in dataclasses.fields(base)}
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


def problem_from(problem: type[DirectProblem], values: Mapping[str, Any]) -> DirectProblem:
    """Make the problem from a node's parameters; its start and solver are the defaults."""
    own = specifications(problem)
    skipped = tuple(f'{name}.' for name in _NOT_OF_THE_PLANT)
    given = {n: v for n, v in values.items() if n in own and not n.startswith(skipped)}
    return problem.from_parameters(given)


class StatedMessages:
    """Names and places of the states and controls of a problem in messages."""

    def __init__(self, problem: DirectProblem) -> None:
        self.states = tuple(problem.state_names)
        self.controls = tuple(problem.control_names)
        joints = dict(problem.joints())
        for joint, pair in joints.items():
            for state in pair:
                if state not in self.states:
                    raise InvalidProblem(
                        f"joints gives '{joint}' the state '{state}', which is not one of "
                        + ', '.join(self.states)
                    )
        moved = {state for pair in joints.values() for state in pair}
        places = {
            joint: (self.states.index(p), self.states.index(v)) for joint, (p, v) in joints.items()
        }
        rest = [(name, i) for i, name in enumerate(self.states) if name not in moved]
        self.joints = (*places, *(name for name, _ in rest))
        self._positions = [*(p for p, _ in places.values()), *(i for _, i in rest)]
        self._velocities = [v for _, v in places.values()]

    def state_message(self, state: Array) -> JointState:
        """Return a state (nx,) as a message without stamp."""
        velocities = np.zeros(len(self.joints))
        velocities[: len(self._velocities)] = state[self._velocities]
        return JointState(
            name=self.joints,
            position=state[self._positions].tolist(),
            velocity=velocities.tolist(),
        )

    def read_state(self, message: JointState) -> Array:
        """
        Return the state (nx,) of a message; joints may come in any order, others are ignored.

        Raises
        ------
        InvalidProblem
            For joints that are missing, lengths that do not match, or values that are not finite.

        """
        index = joint_indices(message.name, self.joints)
        state = np.full(len(self.states), np.nan)
        state[self._positions] = _row(message, 'position', index, self.joints)
        moving = len(self._velocities)
        if moving:
            state[self._velocities] = _row(message, 'velocity', index, self.joints)[:moving]
        return state

    def command_message(self, control: Array) -> JointState:
        """Return controls (nu,) as a message without stamp."""
        return JointState(name=self.controls, effort=control.tolist())

    def error_message(self, error: Array, feedback: Array) -> JointState:
        """Return a deviation (nx,) and the feedback (nu,) within the command."""
        nothing = [0.0] * len(self.states)
        return JointState(
            name=[*self.states, *self.controls],
            position=[*error.tolist(), *([0.0] * len(self.controls))],
            effort=[*nothing, *feedback.tolist()],
        )

    def read_plan(self, motion: Any, controls: Any) -> Trajectory:
        """
        Read a plan from its two messages: states as positions, controls as efforts.

        Raises
        ------
        InvalidProblem
            For messages of different plans, joints that are missing, lengths that do not match,
            or times that do not increase strictly.

        """
        if motion.header.stamp != controls.header.stamp:
            raise InvalidProblem("'trajectory' and 'controls' start at different instants")
        times = _instants(motion)
        if not np.array_equal(times, _instants(controls)):
            raise InvalidProblem(
                "the samples of 'trajectory' and 'controls' differ in their times"
            )
        return Trajectory(
            times=times,
            states=_rows(motion, 'positions', self.states),
            controls=_rows(controls, 'effort', self.controls),
            state_names=self.states,
            control_names=self.controls,
            interpolation='linear',
        )


def _instants(message: Any) -> Array:
    nanoseconds = [nanoseconds_of(point.time_from_start) for point in message.points]
    return np.array(nanoseconds, dtype=float) * NANOSECOND


def _rows(message: Any, quantity: str, names: Sequence[str]) -> Array:
    index = joint_indices(message.joint_names, names)
    rows = [getattr(point, quantity) for point in message.points]
    for number, row in enumerate(rows):
        if len(row) != len(message.joint_names):
            raise InvalidProblem(
                f"trajectory '{quantity}' of point {number} has {len(row)} values for "
                f'{len(message.joint_names)} joints'
            )
    return np.array(rows, dtype=float).reshape(len(rows), -1)[:, index]


def _row(message: Any, quantity: str, index: Sequence[int], names: Sequence[str]) -> Array:
    row = getattr(message, quantity)
    if len(row) != len(message.name):
        raise InvalidProblem(f"'{quantity}' has {len(row)} values for {len(message.name)} joints")
    found = np.array([row[i] for i in index])
    for name, value in zip(names, found, strict=True):
        if not abs(value) <= LARGEST:
            raise InvalidProblem(
                f'the {quantity} of joint {name} is {value}, not a finite number of at most '
                f'{LARGEST:g}'
            )
    return found

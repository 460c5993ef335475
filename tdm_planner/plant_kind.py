# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
How a plant is known to nodes, recordings and pictures: a table of joints with its states.

One message type carries plans, states, commands and tracking errors of every plant; which of its
numbers is which state or control, this table says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, TYPE_CHECKING

import numpy as np
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

if TYPE_CHECKING:  # a simulated robot has no use for what problems need
    from tdm_planner.trajectory import Interpolation

WORLD_FRAME: Final = 'world'  # of the pendulum: the disk's centre, z up, psi about z from x
ARENA_FRAME: Final = 'arena'  # of the robots: a corner, x along the length, y along the width

QUANTITIES: Final = ('position', 'velocity', 'effort')


class Joint(NamedTuple):
    """A joint, and the states or controls that are its position, velocity and effort; '' none."""

    name: str
    position: str = ''
    velocity: str = ''
    effort: str = ''


@dataclass(frozen=True)
class PlantKind:
    """
    The states and controls of a plant, and the joints that they are in messages.

    Poses are those of `frame`. The joints named in `odometry` (x, y, yaw) are measured by an
    odometry, the others by joint states. `interpolation` says how the controls of a plan run
    between its points; None: as they look like. States in `angles` are compared the shorter way
    round.
    """

    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    joints: tuple[Joint, ...]
    state_units: tuple[str, ...] = ()
    control_units: tuple[str, ...] = ()
    frame: str = WORLD_FRAME
    odometry: tuple[str, ...] = ()
    interpolation: Interpolation | None = None
    angles: tuple[str, ...] = ()

    @property
    def leading(self) -> str:
        """Return the topic whose stamps are those of the states."""
        return 'odom' if self.odometry else 'joint_states'

    @cached_property
    def measured(self) -> tuple[Joint, ...]:
        """Joints whose states are in joint states."""
        states = set(self.state_names)
        return tuple(
            joint
            for joint in self.joints
            if joint.name not in self.odometry and states & {joint.position, joint.velocity}
        )

    @cached_property
    def actuated(self) -> tuple[Joint, ...]:
        """Joints that are commanded."""
        controls = set(self.control_names)
        return tuple(j for j in self.joints if controls & {j.velocity, j.effort})

    @property
    def units(self) -> dict[str, str]:
        """Units of states and controls by name, as far as they are known."""
        found = dict(zip(self.state_names, self.state_units, strict=False))
        return found | dict(zip(self.control_names, self.control_units, strict=False))

    def to_dict(self) -> dict[str, Any]:
        """Return what a plan's summary tells of a plant: names, units, joints, interpolation."""
        return {
            'interpolation': self.interpolation,
            'units': self.units,
            'states': self.state_names,
            'controls': self.control_names,
            'joints': {
                joint.name: {q: getattr(joint, q) for q in QUANTITIES if getattr(joint, q)}
                for joint in self.joints
            },
        }

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> PlantKind:
        """Return the plant that `to_dict` told of."""
        states, controls = tuple(told['states']), tuple(told['controls'])
        return cls(
            states,
            controls,
            joints=tuple(Joint(name, **given) for name, given in told['joints'].items()),
            state_units=tuple(told['units'].get(name, '') for name in states),
            control_units=tuple(told['units'].get(name, '') for name in controls),
            interpolation=told['interpolation'],
        )


PENDULUM: Final = PlantKind(
    state_names=RotaryPendulum.state_names,
    control_names=RotaryPendulum.control_names,
    joints=(
        Joint('pendulum', 'theta', 'theta_dot'),
        Joint('disk', 'psi', 'psi_dot', 'torque'),
    ),
    state_units=RotaryPendulum.state_units,
    control_units=RotaryPendulum.control_units,
    angles=('theta',),
)

# The wheel's angle and speed are no states of a plan; they are told where they are known.
ROBOT: Final = PlantKind(
    state_names=FloatingRobot.state_names,
    control_names=FloatingRobot.control_names,
    joints=(
        Joint('x', 'x', 'u'),
        Joint('y', 'y', 'v'),
        Joint('yaw', 'yaw', 'omega'),
        Joint('thruster', 'alpha', 'thruster_rate', 'thrust'),
        Joint('reaction_wheel', 'wheel_angle', 'wheel_speed', 'torque'),
    ),
    state_units=FloatingRobot.state_units,
    control_units=FloatingRobot.control_units,
    frame=ARENA_FRAME,
    odometry=('x', 'y', 'yaw'),
    angles=('yaw', 'alpha'),
)


def named_kind(
    states: Sequence[str],
    controls: Sequence[str] = (),
    joints: Sequence[tuple[str, str, str]] = (),
    units: tuple[tuple[str, ...], tuple[str, ...]] = ((), ()),
) -> PlantKind:
    """
    Return a plant whose joints are named like its states (positions) and controls (efforts).

    `joints` are the exceptions: name, and the states that are its position and velocity.
    """
    moved = {state for _, *pair in joints for state in pair}
    table = {name: Joint(name, position, velocity) for name, position, velocity in joints}
    table |= {name: Joint(name, name) for name in states if name not in moved}
    for name in controls:
        table[name] = table.get(name, Joint(name))._replace(effort=name)
    return PlantKind(
        tuple(states), tuple(controls), tuple(table.values()), *units, interpolation='linear'
    )


def kind_of(problem: Formulation) -> PlantKind:
    """
    Return the plant of a stated problem: its `joints`, the other states and controls by name.

    Raise InvalidProblem if `joints` names what is not a state, gives a joint no pair, or the name
    of another state.
    """
    given = CheckedFormulation(problem).call('joints')
    pairs = given.values() if isinstance(given, Mapping) else (None,)
    if any(np.shape(np.array(pair, object)) != (2,) for pair in pairs):
        raise InvalidProblem(
            'joints must give every joint by name the states that are its position and velocity: '
            "{'arm': ('angle', 'rate')}"
        )
    joints = [(name, *pair) for name, pair in given.items()]
    for name, state in [(name, state) for name, *pair in joints for state in pair]:
        if state not in problem.state_names:
            raise InvalidProblem(
                f"joints gives '{name}' the state '{state}', which is not one of "
                + ', '.join(problem.state_names)
            )
    for name in {*given} & {*problem.state_names}.difference(*given.values()):
        raise InvalidProblem(
            f"joints gives the name '{name}' of a state that is in none of its pairs to other "
            'states: give the joint another name'
        )
    units = tuple(problem.state_units), tuple(problem.control_units)
    return named_kind(problem.state_names, problem.control_names, joints, units)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What demo, report and pictures know of a plant beside its joints: one class a plant.

A plant says when it is at its goal, what it must keep, and what it looks like. Without a known
problem, none of this is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from types import MappingProxyType
from typing import ClassVar, get_args, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.direct_method.hints import told
from tdm_planner.drawing import (
    arena_drawing,
    Components,
    Drawn,
    PendulumDrawing,
    points_of,
    RobotDrawing,
    Shape,
)
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plant_kind import kind_of, named_kind, PENDULUM, PlantKind, ROBOT
from tdm_planner.plants.floating_robot import RobotLimits
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.problem import Problem
from tdm_planner.tracking.motion import finished
from tdm_planner.tracking.pendulum_tracking import PACES, settling, UPRIGHT
from tdm_planner.tracking.robot_tracking import GOAL_DISTANCE, GOAL_TURN, settling_time
from tdm_planner.tracking.stated_tracking import (
    GOAL_SHARE,
    StatedTracker,
    StatedTrackerParameters,
)
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

THRUST = 'thrust'

_LIMIT_SHARE = 0.05  # of a limit's size, that feedback needs beyond it
_ROUNDING = 1e-9
_NO_THRUST = 1e-6  # N


class Tolerance(NamedTuple):
    """States whose deviation from the goal, together, must stay below `allowed`, in their unit."""

    states: tuple[str, ...]
    allowed: float


class PlantView(Drawn):
    """
    A plant as verdict, report and pictures know it.

    This one is a plant of which only the names are known: nothing is judged or drawn.

    `name` is that of a vehicle that has no other. `enforced` are the limits that the plant keeps
    by itself; `goal_tolerances` the deviations within which the goal counts as reached, where they
    do not depend on the plan; `place` the states that are its place in the plane, where several of
    a kind keep a distance, `separation` [m] if it is known; `bounds` the levels that limit a state
    or a control, by name.
    """

    _settling: float = 0.0  # s
    separation: float | None = None
    enforced: ClassVar[frozenset[str]] = frozenset()
    place: ClassVar[tuple[str, ...]] = ()
    goal_tolerances: ClassVar[tuple[Tolerance, ...]] = ()
    labels: ClassVar[Mapping[str, str]] = {}
    name: str = 'vehicle'
    title: str = ''
    bounds: Mapping[str, tuple[float, ...]] = MappingProxyType({})

    def __init__(
        self, kind: PlantKind, problem: Problem | None = None, drawn: Drawn | None = None
    ) -> None:
        self.kind, self.problem, self._drawn = kind, problem, drawn or Drawn()
        self.surroundings = self._drawn.surroundings

    def goal(self, plan: Trajectory) -> tuple[Array, tuple[Tolerance, ...]]:
        """Return the state (nx,) that a plan leads to, and what it may be missed by."""
        return plan.states[-1], self.goal_tolerances

    def settling(self, duration: float) -> float:
        """Return the time [s] after the end of a plan by which its goal must be reached."""
        return self._settling

    def is_held(self, plan: Trajectory) -> bool:
        """Whether the goal is held after the end of the plan."""
        return True

    def end_conditions(self, time: float, state: Array) -> Array:
        """Return what must vanish at the end beside the goal, as shares of what is allowed."""
        return np.zeros(0)

    def constraints(self, plan: Trajectory) -> Sequence[Constraint]:
        """Return the limits of one vehicle's motion."""
        return () if self.problem is None else self.problem.constraints_on(plan)

    def allowed(self, limit: str, plan: Trajectory) -> float:
        """Return what a limit may be violated by on a flight of a plan, in its unit."""
        return _ROUNDING

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Return what the plant looks like in states `x`, under controls `u`."""
        return self._drawn.drawing(x, u)

    def check_drawing(self) -> None:
        """Raise InvalidProblem where a user's drawing fails."""

    def missed_by(self, plan: Trajectory, states: Components) -> list[tuple[Tolerance, Array]]:
        """Return the tolerances of a plan's goal, and how far states are from it by each (n,)."""
        goal, tolerances = self.goal(plan)
        at = dict(zip(plan.state_names, goal.tolist(), strict=True))
        return [
            (t, np.sqrt(sum(self.away(name, states[name] - at[name]) ** 2 for name in t.states)))
            for t in tolerances
        ]

    def away(self, state: str, difference: Array) -> Array:
        """Return the difference of two values of a state, the shorter way round for angles."""
        if state not in self.kind.angles:
            return difference
        return wrapped(difference)


class PendulumView(PlantView):
    """The rotary pendulum, upright at the end; a swing-up may use all of the disk's range."""

    name = 'pendulum'
    title = 'Swing-up of the rotary pendulum'
    _settling = 3.0
    goal_tolerances = (Tolerance(('theta',), UPRIGHT),)
    labels: ClassVar[Mapping[str, str]] = {
        'theta': 'pendulum from upright',
        'psi': 'disk',
        'theta_dot': 'pendulum rate',
        'psi_dot': 'disk rate',
        'torque': 'motor of the disk',
        'disk_angle': 'end stops of the disk',
    }

    def __init__(self, problem: PendulumSwingUp | None = None) -> None:
        drawn = PendulumDrawing(RotaryPendulum())
        if problem is not None:
            torque, angle = problem.limits.torque, problem.limits.disk_angle
            drawn = PendulumDrawing(problem.plant, torque, angle)
            self._settling = settling(problem.plant)
            self.bounds = {'torque': (-torque, torque), 'psi': (-angle, angle)}
        super().__init__(PENDULUM, problem, drawn)

    def settling(self, duration: float) -> float:
        """Return the same, and the delay of a rig that swings more slowly."""
        return self._settling + (1.0 / PACES[0] - 1.0) * duration

    def allowed(self, limit: str, plan: Trajectory) -> float:
        """Return room for the feedback beyond the disk's angle, none beyond the torque."""
        if limit == 'disk_angle' and 'psi' in self.bounds:
            return _LIMIT_SHARE * self.bounds['psi'][1]
        return super().allowed(limit, plan)


class RobotView(PlantView):
    """A robot of a formation, in its place at the end."""

    title = 'Formation of floating robots'
    _settling = settling_time(RobotLimits())
    goal_tolerances = (Tolerance(('x', 'y'), GOAL_DISTANCE), Tolerance(('yaw',), GOAL_TURN))
    enforced = frozenset({THRUST, 'thruster_rate', 'torque'})
    place = ('x', 'y')
    labels: ClassVar[Mapping[str, str]] = {
        'x': 'position',
        'y': 'position',
        'u': 'velocity along x',
        'v': 'velocity along y',
        'yaw': 'yaw',
        'omega': 'yaw rate',
        'alpha': 'thruster angle',
        'thrust': 'thruster',
        'thruster_rate': 'turning of the thruster',
        'torque': 'reaction wheel',
        'walls': 'and safety radius',
        'keep_out': 'zones and safety radius',
    }

    def __init__(self, problem: RobotFormation | None = None) -> None:
        drawn = RobotDrawing()
        if problem is not None:
            arena, limits = problem.arena, problem.limits
            self.separation = arena.minimum_separation
            self._settling = settling_time(limits)
            drawn = RobotDrawing(self.separation, limits.thrust, surroundings=arena_drawing(arena))
            half = self.separation / 2
            self.bounds = {  # walls less the safety radius, and the actuators
                'x': (half, arena.length - half),
                'y': (half, arena.width - half),
                THRUST: (0.0, limits.thrust),
                'thruster_rate': (-limits.thruster_rate, limits.thruster_rate),
                'torque': (-limits.torque, limits.torque),
            }
        super().__init__(ROBOT, problem, drawn)

    def constraints(self, plan: Trajectory) -> Sequence[Constraint]:
        """Limits of one robot; one that coasts is not at the limit of its thrust."""

        def left(t: Array, x: Array, u: Array) -> Array:
            thrust = u[:, 0]
            return np.where(thrust < -_NO_THRUST, thrust, self.bounds[THRUST][1] - thrust)

        found = super().constraints(plan)
        return [replace(c, margin=left) if c.name == THRUST else c for c in found]


class _Flown(NamedTuple):
    """Ranges of a plan's states (nx,), sizes of limits by name, whether its end can be held."""

    ranges: Array
    limits: Mapping[str, float]
    held: bool


class StatedView(PlantView):
    """A plant of a statement: its own end conditions and limits, and its own drawing."""

    _settling = StatedTracker.settling
    problem: DirectProblem

    def __init__(self, problem: DirectProblem) -> None:
        super().__init__(kind_of(problem), problem)
        self._stated = CheckedFormulation(problem)
        self._flown = cache(self._flown_along)  # by a plan's identity
        self.name = self.title = problem.name
        limits = self._stated.control_limits.items()
        self.bounds = {name: tuple(v for v in both if np.isfinite(v)) for name, both in limits}

    def allowed(self, limit: str, plan: Trajectory) -> float:
        """Return a share of what the limit changes by along the plan: feedback needs room."""
        return _LIMIT_SHARE * self._flown(plan).limits.get(limit, 1.0)

    def check_drawing(self) -> None:
        """Draw the start, then both ends at once, as a report draws all instants."""
        ends = np.nan_to_num(self._ends.states)
        with np.errstate(all='ignore'):
            self.shapes(ends[0])
            self.shapes(ends)

    @cached_property
    def _ends(self) -> Ends:
        return Ends.of(self._stated)

    def _flown_along(self, plan: Trajectory) -> _Flown:
        law = finished(StatedTracker(self.problem, StatedTrackerParameters()).prepare(plan))
        plant = DirectPlant(self.problem)
        half = 0.5 * np.diff(plant.control_range, axis=0)[0]
        controls = np.where(np.isfinite(half), half, np.abs(plan.controls).max(axis=0))
        sizes = plant.limit_sizes(plan, law.ranges, controls).tolist()
        limits = dict(zip(plant.trace.margin_names, sizes, strict=True))
        return _Flown(law.ranges, limits, law.end is not None)

    def goal(self, plan: Trajectory) -> tuple[Array, tuple[Tolerance, ...]]:
        """Every state that the statement gives the end of, within a share of its range."""
        end = self._ends.states[1]
        given = np.isfinite(end)
        tolerances = tuple(
            Tolerance((name,), GOAL_SHARE * float(size))
            for name, size, known in zip(
                plan.state_names, self._flown(plan).ranges, given, strict=True
            )
            if known
        )
        return np.where(given, end, plan.states[-1]), tolerances

    def is_held(self, plan: Trajectory) -> bool:
        """Whether some control keeps the plan's end."""
        return self._flown(plan).held

    def end_conditions(self, time: float, state: Array) -> Array:
        """Return the conditions, of order one, as shares of what is allowed."""
        found = self._stated.parts('end_conditions', np.array([time]), state[None])
        return np.array([float(value[0]) / GOAL_SHARE for value in found])

    def drawing(self, x: Components, u: Components) -> Sequence[Shape]:
        """Return what the statement draws."""
        values = [x[name] for name in self.problem.state_names]
        try:
            found = self.problem.drawing(values)
            if isinstance(found, get_args(Shape)):
                raise TypeError('one shape is returned, expected a sequence, such as (shape,)')
            shapes = list(found)
            for shape in shapes:
                points_of(shape, np.asarray(values[0]).size)
        except Exception as error:  # noqa: B902
            raise InvalidProblem(told(self.problem, 'drawing', error)) from error
        return shapes


def view_of(problem: Problem | None, plan: Trajectory | None = None) -> PlantView:
    """
    Return how the plant of a problem is judged and drawn.

    A problem that is not of this package, or not known, has the plant of which the `plan` names
    the states and controls; if that is unknown, they name joints.
    """
    if isinstance(problem, PendulumSwingUp):
        return PendulumView(problem)
    if isinstance(problem, RobotFormation):
        return RobotView(problem)
    if isinstance(problem, DirectProblem):
        return StatedView(problem)
    if plan is None:
        return PlantView(named_kind(()), problem)
    names, units = (plan.state_names, plan.control_names), (plan.state_units, plan.control_units)
    for view in (PendulumView(), RobotView()):
        if problem is None and {*view.kind.state_names} <= {*plan.state_names}:
            return view
        if (view.kind.state_names, view.kind.control_names) == names:
            return PlantView(view.kind, problem)
    return PlantView(named_kind(*names, units=units), problem)

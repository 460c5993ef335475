# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plants that the planner node knows: one class for each, the first for any stated problem.

A class says what is measured, how the plant moves until a plan begins, how its tracker executes
plans, and how it is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
import math
from typing import Any, ClassVar

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.drawing import (
    arena_drawing,
    Drawn,
    DrawnPath,
    PendulumDrawing,
    RobotDrawing,
    Shape,
)
from tdm_planner.exceptions import InvalidProblem, NotFinite
from tdm_planner.parameters import build, specifications
from tdm_planner.plant_kind import kind_of, named_kind, PENDULUM, PlantKind, ROBOT
from tdm_planner.plant_views import StatedView
from tdm_planner.plants.pendulum_replay import roll_states
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.formation.parameters import Arena, place_in_arena
from tdm_planner.problems.pendulum.task import PENDULUM_NAME
from tdm_planner.problems.planner_parameters import PlannerParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.execution import (
    Execution,
    GenericExecution,
    PLANT_NAME,
    ranges_of,
    START,
    TimedPlan,
)
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.swing_up_execution import SwingUpExecution
from tdm_planner.tracking.motion import TrackerParameters
from tdm_planner.tracking.pendulum_tracking import PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTrackerParameters
from tdm_planner.tracking.stated_tracking import StatedTrackerParameters
from tdm_planner.trajectory import Trajectory

Values = Mapping[str, Any]

_OF_THE_NODE = specifications(PlannerParameters).keys()
_CLEARLY = 0.35  # of one state, by which a plant moves freely; noise of one at rest gives less
_PREDICTABLE = 2000  # rad of swinging at the natural frequency
_APART, _LATELY = 0.05, 10.0  # s between states that tell whether a plant moves: least, most


class PlannedPlant:
    """
    The plant of any problem, as the planner node knows it.

    Its state is measured with the joints of a stated problem, or with the numbers X of the
    parameters `start.X` for joints. A problem without such parameters has nothing to measure.
    Until a plan begins, the tracker holds it where it can, or it moves on without control. How
    fast feedback removes deviations is not known.

    `vehicle` is its name in plans. `tracker` is the class of its tracker's parameters, None if it
    is not of this package. `tracking_bounds` are the largest deviations (nx,) of a plant that
    follows its plan, None if they depend on that. `rests_before_start` says whether the plant
    may stay at rest until the plan starts.
    """

    vehicle: ClassVar[str] = PLANT_NAME
    tracking_bounds: ClassVar[Array | None] = None
    rests_before_start: ClassVar[bool] = True
    several: ClassVar[bool] = False  # each with topics below its name
    moves = False  # without a plan, as it was predicted last

    def __init__(
        self, problem: type[Problem], kind: PlantKind, tracker: type[TrackerParameters] | None
    ) -> None:
        self._problem, self.kind, self.tracker = problem, kind, tracker
        self._past: tuple[tuple[Array, float], ...] = ()  # states and instants

    def observe(self, state: Array, at: float) -> None:
        """Remember a state (nx,), measured at the instant `at` [s], of the only plant."""
        if not self._past or not 0.0 <= at - self._past[-1][1] < _APART:
            self._past = (*self._past[-2:], (state, at))

    def tracking_tolerance(self, plan: Trajectory, values: Values) -> Array:
        """Return the largest deviations (nx,) of a plant that follows its plan."""
        if self.tracking_bounds is None:
            return np.asarray(values['replan.deviation'] * ranges_of(plan))
        return self.tracking_bounds

    def predict_without_plan(
        self, state: Array, since: float, until: float, values: Values
    ) -> Array:
        """
        Predict the state (nx,) from the instant `since` [s] to `until`, without a plan.

        A stated plant may be held where it is, or move on without control: what it has done since
        two earlier states decides. Any other rests.
        """
        self.moves = False
        stated, names = self._problem, self.kind.state_names
        known = issubclass(stated, DirectProblem) and names == tuple(stated.state_names)
        past = [(x, since - at) for x, at in self._past[:2] if 0.0 < since - at < _LATELY]
        if not (known and past and since < until):
            return state

        def moved(begin: Array, seconds: float) -> Array:
            times, both = np.array([0.0, seconds]), np.stack([begin, begin])
            nothing = np.zeros((2, len(plant.control_names)))
            free = plant.replay(Trajectory.of(plant, times, both, nothing))
            return np.asarray(free.states(times)[-1])

        # Parameters start.X that are invalid do not matter: the state is to replace them.
        with suppress(InvalidProblem, NotFinite):
            problem: Any = stated.from_parameters(values)
            plant = DirectPlant(problem)
            off = np.abs([moved(*before) - state for before in past])
            changed = np.abs([before - state for before, _ in past])
            share = off / np.maximum(off + changed, 1e-300)
            if (share - 0.5)[off + changed > 0.0].sum() < -_CLEARLY * len(past):
                ahead = moved(state, until - since)
                self.moves = not np.array_equal(ahead, state)
                return ahead
        return state

    def remaining_deviation(self, away: Array, duration: float) -> Array:
        """Return the rest of a deviation (nx,) after `duration` s under feedback."""
        return away

    def execution(self, plan: TimedPlan, trackers: Mapping[str, Any], values: Values) -> Execution:
        """Return the model of how trackers execute a plan. In the worker's thread."""
        return GenericExecution(plan, self.kind.state_names, values['replan.deviation'])

    def extra_joints(self, problem: Any, trajectory: Trajectory) -> Mapping[str, Array]:
        """Return histories (N,) of joints beside the states and controls, by name."""
        return {}

    def drawn(self, values: Values) -> Drawn | None:
        """Return what a plant looks like; None where not all of its state is measured."""
        if not issubclass(self._problem, DirectProblem):
            return None
        view = StatedView(self._problem.from_parameters(values))
        if view.kind.state_names != self.kind.state_names:
            return None
        view.check_drawing()
        return view

    def preview(self, values: Values) -> tuple[Sequence[Shape], Sequence[DrawnPath]] | None:
        """Return surroundings and goals to draw before there is a plan; None: nothing."""
        return None


class PlannedPendulum(PlannedPlant):
    """The rotary pendulum; between plans it swings without torque."""

    vehicle = PENDULUM_NAME
    tracking_bounds = np.array([0.5, 0.7, 6.0, 8.0])
    rests_before_start = False

    def predict_without_plan(
        self, state: Array, since: float, until: float, values: Values
    ) -> Array:
        """Predict the state (4,) without torque; also back."""
        duration = until - since
        plant = build(RotaryPendulum, values, 'plant.')
        swung = abs(duration) * plant.natural_frequency
        if swung > _PREDICTABLE:
            raise InvalidProblem(
                f"parameters 'start.delay' and 'start.max_age' require a prediction over "
                f'{duration:.3g} s, {swung:.3g} rad of swinging: at most {_PREDICTABLE} rad'
            )
        count = math.ceil(10.0 * swung) + 1  # backwards each is one step
        intervals = np.full(count, duration / count)
        return np.asarray(roll_states(plant, state, intervals, np.zeros(count))[-1])

    def remaining_deviation(self, away: Array, duration: float) -> Array:
        """Return zero (4,): the feedback removes the deviation."""
        return np.zeros_like(away)

    def execution(self, plan: TimedPlan, trackers: Mapping[str, Any], values: Values) -> Execution:
        """Return the tracker's feedback as a model."""
        return SwingUpExecution(plan, trackers.get(PENDULUM_NAME))

    def drawn(self, values: Values) -> Drawn:
        """Return the rig with these parameters."""
        plant = build(RotaryPendulum, values, 'plant.')
        return PendulumDrawing(plant, values['limits.torque'], values['limits.disk_angle'])


class PlannedRobots(PlannedPlant):
    """The robots of a formation; between plans they drift."""

    # The thruster may turn as it likes.
    tracking_bounds = np.array([0.15, 0.15, 0.1, 0.1, 0.3, 0.3, np.inf])
    rests_before_start = False
    several = True

    def predict_without_plan(
        self, state: Array, since: float, until: float, values: Values
    ) -> Array:
        """Predict the state (7,) without thrust or torque."""
        _, _, u, v, _, omega, _ = state
        return state + (until - since) * np.array([u, v, 0.0, 0.0, omega, 0.0, 0.0])

    def remaining_deviation(self, away: Array, duration: float) -> Array:
        """Return a deviation (7,) that drifts: only the thruster's angle is corrected quickly."""
        return self.predict_without_plan(away, 0.0, duration, {}) * (np.arange(7) < 6)

    def execution(self, plan: TimedPlan, trackers: Mapping[str, Any], values: Values) -> Execution:
        """Return the trackers' feedback as a model."""
        return FormationExecution(plan, trackers)

    def extra_joints(self, problem: RobotFormation, trajectory: Trajectory) -> Mapping[str, Array]:
        """Return the change of the wheel's speed since the start."""
        omega = trajectory.state('omega')
        return {'wheel_speed': problem.plant.wheel_speed(omega - omega[0])}

    def drawn(self, values: Values) -> Drawn:
        """Return a robot with these parameters."""
        return RobotDrawing(values['arena.minimum_separation'], values['limits.thrust'])

    def preview(self, values: Values) -> tuple[Sequence[Shape], Sequence[DrawnPath]]:
        """Return the arena, and the robots in their places of the formation."""
        around, drawn = arena_drawing(build(Arena, values, 'arena.')), self.drawn(values)
        ways = []
        for name in values['robots']:
            place = values.get(f'formation.{name}')
            if place is not None:
                x, y, yaw = place_in_arena(values['formation.anchor'], place)
                ways.append(DrawnPath(drawn, np.array([[x, y, 0.0, 0.0, yaw, 0.0, 0.0]]), name))
        return around, ways


def planned_plant(problem: type[Problem], values: Values) -> PlannedPlant:
    """Return the plant of a class of problems, with the values of a planner's parameters."""
    if issubclass(problem, PendulumSwingUp):
        return PlannedPendulum(problem, PENDULUM, PendulumTrackerParameters)
    if issubclass(problem, RobotFormation):
        return PlannedRobots(problem, ROBOT, RobotTrackerParameters)
    wanted = [
        name.removeprefix(START)
        for name, value in values.items()
        if name.startswith(START) and name not in _OF_THE_NODE and isinstance(value, float)
    ]
    if not issubclass(problem, DirectProblem):
        return PlannedPlant(problem, named_kind(wanted), None)
    kind = kind_of(problem())
    known = tuple(name for name in kind.state_names if name in wanted)
    kind = replace(kind, state_names=known) if len(known) == len(wanted) else named_kind(wanted)
    return PlannedPlant(problem, kind, StatedTrackerParameters)

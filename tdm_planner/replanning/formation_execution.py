# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A formation's plan under its trackers' feedback, and what pushes do to the distances kept.

A robot that was pushed drifts until its thruster has turned and the thrust has taken the drift
away; then the feedback brings it back. The drift is bounded in closed form, for all robots and
instants at once, rather than integrated: it has to be looked at before every plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import itertools
import math

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.plants.base import integrate
from tdm_planner.problems.formation.parameters import RobotStart
from tdm_planner.problems.formation.problem import RobotFormation
from tdm_planner.problems.formation.search import LATE
from tdm_planner.problems.formation.verification import gas_used, robot_constraints
from tdm_planner.replanning.execution import (
    Execution,
    Observation,
    Outlook,
    Predicted,
    TimedPlan,
)
from tdm_planner.tracking.estimator import PREDICTION_STEP
from tdm_planner.tracking.motion import finished, Motion, ObservedPhase
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.trajectory import Sample

_STEP = 0.05  # s between the commands that are looked ahead with
_GRID = 0.1  # s between the instants at which distances are looked at
_BRAKING = 0.7  # of the largest thrust, that brakes a drift
_RETURN = 3.0  # s, time constant with which the feedback brings a robot back
_RESERVE = 0.25  # of arena.tracking_margin that must be left of the distances
_NOISE, _LEFT = 1e-3, 7.5e-3  # m of a distance that mean nothing; that feedback leaves, at most
# A robot so near to its goal, and so slow, is kept there by its tracker: m, m/s, rad, rad/s.
_AT_GOAL = np.array([0.03, 0.015, 0.05, 0.02])
# A robot late on its way that is so near to its plan is brought back on it by its tracker.
_ON_PLAN = np.array([0.03, 0.015, 0.05, 0.04])
_STANDING = {'walls': 'a wall', 'keep_out': 'a keep-out zone'}  # limits of a robot's place
_TRACKED = 0.8  # of tolerance.path that a deviation may come to


class FormationExecution(Execution):
    """
    The robots' trackers as a model of what they will do.

    `parameters` are the trackers' by robot; where they are not known, the defaults with the
    problem's plant and limits.
    """

    def __init__(
        self,
        plan: TimedPlan,
        parameters: Mapping[str, RobotTrackerParameters | None] = {},
    ) -> None:
        super().__init__(plan)
        assert isinstance(plan.problem, RobotFormation)
        self._problem = problem = plan.problem
        default = RobotTrackerParameters(plant=problem.plant, limits=problem.limits)
        self._trackers: dict[str, RobotTracker] = {}
        self._motions: dict[str, Motion] = {}
        for name, trajectory in plan.solution.trajectories.items():
            own = replace(parameters.get(name) or default, rate=1.0 / _STEP)
            # At so low a rate the servo must take all of its error away at once.
            self._trackers[name] = tracker = RobotTracker(own, servo_share=1.0)
            law = finished(tracker.prepare(trajectory))
            self._motions[name] = Motion(trajectory, plan.start, law)

    def predict(self, observations: Mapping[str, Observation], at: float) -> dict[str, Predicted]:
        """Step every robot under its feedback from the measured state to the instant `at`."""
        task = self._problem.task
        found = {}
        for i, name in enumerate(task.names):
            arrived = float(task.arrived[i]) if task.staying[i] else 0.0
            duration = 0.0 if arrived else self._motions[name].trajectory.duration
            arrived = max(arrived + self.plan.elapsed(at) - duration, 0.0)
            state, control = self._moved(name, observations[name], at)
            phase = observations[name].phase
            planned = self._planned(name, state, at) if phase is ObservedPhase.FOLLOWING else None
            found[name] = Predicted(state, control, phase, arrived, planned)
        return found

    def _planned(self, name: str, state: Array, at: float) -> Sample | None:
        """
        Return what the plan has for a robot late on its way and well on it, else None.

        The feedback takes its deviation away; planned from that it would only be later.
        """
        motion = self._motions[name]
        left = motion.end - at
        late = LATE * self._problem.task.half_turn
        planned = motion.sample(at)
        return planned if 0.0 < left < late and _near(planned.state, state, _ON_PLAN) else None

    def _moved(self, name: str, seen: Observation, at: float) -> tuple[Array, Array]:
        """Return a robot's state (7,) at the instant `at`, and the controls (3,) there."""
        tracker, motion = self._trackers[name], self._motions[name]
        state, time = np.concatenate([seen.state, np.ones(2)]), seen.stamp
        control = np.zeros(3)
        while time < at - 1e-9:
            step = min(_STEP, at - time)
            if seen.phase is ObservedPhase.FOLLOWING:
                act = tracker.track if time < motion.end else tracker.hold
                control = act(motion, time, state).control
            elif seen.phase is ObservedPhase.RECOVERING:
                control = tracker.recover(state)
            state[:7] = integrate(self._problem.plant, state[:7], control, step, PREDICTION_STEP)
            time += step
        return state[:7], control

    def outlook(self, predicted: Mapping[str, Predicted], at: float) -> Outlook:
        """Carry the deviations on and look at the distances they leave."""
        following = ObservedPhase.FOLLOWING
        lost = [name for name, robot in predicted.items() if robot.phase is not following]
        if lost:
            return Outlook(failure=f"'{lost[0]}' does not follow the active plan any more")
        end = max(self.plan.end, at + _GRID)
        times = np.linspace(at, end, max(2, math.ceil((end - at) / _GRID)))
        planned, places = {}, {}
        for name, robot in predicted.items():
            away = self._deviation(name, robot, at, times - at)
            peak = float(np.hypot(away[:, 0], away[:, 1]).max())
            if peak > _TRACKED * self._trackers[name].parameters.tolerance.path:
                return Outlook(failure=f"'{name}' would come {peak:.2g} m off the active plan")
            planned[name] = self._motions[name].sample(times).state[:, :2]
            places[name] = planned[name] + away
        failure = self._nearness(places, planned)
        settled = not failure and all(
            _near(self._motions[name].trajectory.states[-1], robot.state, _AT_GOAL)
            for name, robot in predicted.items()
        )
        return Outlook(self._cost(predicted, at), failure, settled)

    def _deviation(self, name: str, robot: Predicted, at: float, since: Array) -> Array:
        """Deviations (n, 2) m from the plan, `since` (n,) s after the instant `at`."""
        reference = self._motions[name].reference(at)
        offset, drift = robot.state[:2] - reference[:2], robot.state[2:4] - reference[2:4]
        speed = float(np.hypot(*drift))
        limits = self._trackers[name].parameters.limits
        largest = limits.thrust / self._problem.plant.mass
        heading = math.atan2(-drift[1], -drift[0]) - robot.state[4] - robot.state[6]
        turn = abs(math.remainder(heading, math.tau)) / limits.thruster_rate
        braking = speed / (_BRAKING * largest)
        drifting = np.minimum(since, turn)
        slowing = np.clip(since - turn, 0.0, braking)
        path = drifting + slowing - (0.5 * slowing**2 / braking if braking > 0.0 else 0.0)
        back = np.exp(-np.maximum(since - turn - braking, 0.0) / _RETURN)
        return np.asarray((offset + drift * path[:, None]) * back[:, None])

    def _nearness(self, places: Mapping[str, Array], planned: Mapping[str, Array]) -> str:
        """Return what comes nearer than allowed, and than a plan that may just keep to that."""
        task, reserve = self._problem.task, _RESERVE * self._problem.arena.tracking_margin
        slack, nothing = min(max(reserve, _NOISE), _LEFT), np.zeros(0)
        limits = [limit for limit in robot_constraints(task) if limit.name in _STANDING]
        for name, limit in itertools.product(places, limits):
            ways = places[name], planned[name]
            left, wanted = (limit.margin(nothing, way, nothing).min() for way in ways)
            if left < min(0.0, wanted - slack):
                near = f'{left + task.separation / 2:.3g} m near {_STANDING[limit.name]}'
                return f"'{name}' would come {near}"
        for one, other in itertools.combinations(places, 2):
            apart, way = (np.linalg.norm(p[one] - p[other], axis=1) for p in (places, planned))
            # What is too near now cannot be mended by any plan.
            least = min(task.separation + reserve, apart[0] - _NOISE, way.min() - slack)
            if apart.min() < least:
                return f"'{one}' and '{other}' would come within {apart.min():.3g} m"
        return ''

    def _cost(self, predicted: Mapping[str, Predicted], at: float) -> float:
        """J of what is left of the plan, and the gas that taking the deviations away costs."""
        rest = self.plan.remainder(at)
        if rest is None:
            return 0.0
        task = replace(self._problem.task, arrived=np.zeros(len(predicted)))
        arrivals, gas = [], []
        for name in task.names:
            motion = self._motions[name]
            left = motion.end - at
            arrivals.append(-predicted[name].arrived if predicted[name].arrived else left)
            used = gas_used(task.plant, rest.trajectories[name])
            drift = predicted[name].state[2:4] - motion.reference(at)[2:4]
            gas.append((used if left > 0.0 else 0.0) + float(np.hypot(*drift)))
        return sum(task.cost_terms(np.array(arrivals), np.array(gas)).values())

    def problem_from(
        self, problem: RobotFormation, predicted: Mapping[str, Predicted]
    ) -> RobotFormation:
        """Return the manoeuvre from the predicted states; robots kept at their goal stay there."""
        task = problem.task
        starts = {}
        for i, name in enumerate(task.names):
            robot = predicted[name]
            goal = np.array([*task.goal[i], 0.0, 0.0, task.goal_yaw[i], 0.0, robot.state[6]])
            state, control = robot.state, robot.control
            planned_end = self._motions[name].trajectory.states[-1]
            if robot.planned is not None and _near(goal, planned_end, _AT_GOAL):
                state, control = robot.planned
            if _near(goal, robot.state, _AT_GOAL):
                state, control = goal, np.zeros(3)
            now = dict(zip(task.plant.state_names, state.tolist(), strict=True))
            thrust, _, torque = control.tolist()
            starts[name] = RobotStart(**now, thrust=thrust, torque=torque, arrived=robot.arrived)
        return replace(problem, starts=starts)


def _near(planned: Array, state: Array, allowed: Array) -> bool:
    """Whether place, velocity, yaw and its rate differ by less than `allowed` (4,)."""
    away = state - planned
    turn = math.remainder(away[4], math.tau)
    sizes = [math.hypot(*away[:2]), math.hypot(*away[2:4]), abs(turn), abs(away[5])]
    return bool((np.array(sizes) < allowed).all())

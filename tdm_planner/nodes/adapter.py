# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Connects a problem to ROS: the plants' states, trackers and goals, plan messages, markers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import math
import textwrap
from typing import Any, TypeVar

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
import numpy as np
from rclpy.node import Node
from tdm_planner.arrays import Array, wrapped
from tdm_planner.drawing import DrawnPath
from tdm_planner.exceptions import Failure, InvalidProblem, NoState
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.markers import MARKER_DEPTH, MARKER_RATE, Pen, Picture, plan_markers
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.nodes.messages import LATCHED, path_message, plan_message, to_stamp
from tdm_planner.nodes.reading import check_frame, yaw_of
from tdm_planner.nodes.services import Request
from tdm_planner.nodes.tracker_plans import TrackerWatch
from tdm_planner.plant_views import view_of
from tdm_planner.problems.formation.parameters import place_in_arena, place_in_formation
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.execution import Observation, TimedPlan
from tdm_planner.replanning.planned_plants import planned_plant, PlannedPlant, Values
from tdm_planner.replanning.replanner import PublishedPlans, SAME_START
from tdm_planner.tracking.motion import ObservedPhase
from tdm_planner.trajectory import TimedTrajectory, Trajectory
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

T = TypeVar('T')

_OLDEST_SHOWN = 0.5  # s; a state older than that is not drawn any more
_NOTICE_TIME = 8.0  # s that the notice of a rejected goal stays visible
_LETTERS = 0.1  # m
_LINE = 44  # letters


class Vehicle:
    """
    A plant of a planner and its topics; of several plants each has its `prefix`, 'robot1/'.

    A pose on `<robot>/goal_pose`, from RViz or Foxglove, asks for a plan with the robot's place in
    the formation moved there (`formation.<robot>`, which is set if there is a plan).
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        name: str,
        plant: PlannedPlant,
        values: Values,
        request: Callable[[Request], None],
    ) -> None:
        self._node, self._clock, self._plant, self._request = node, clock, plant, request
        self.name, kind = name, plant.kind
        self.prefix = prefix = f'{name}/' if plant.several else ''
        group = f'{name}.start' if plant.several else 'start'
        self.start_parameters = [f'{group}.{state}' for state in kind.state_names]
        self.label = f"robot '{name}': " if plant.several else ''  # begins a sentence
        self._angles = np.array([state in kind.angles for state in kind.state_names])
        self.trajectory = node.create_publisher(JointTrajectory, f'{prefix}trajectory', LATCHED)
        self.path = (
            node.create_publisher(Path, f'{prefix}path', LATCHED) if kind.odometry else None
        )
        self.tracker = TrackerWatch(node, clock, prefix, plant.tracker)
        self._picture: Picture | None = None
        self.measured = MeasuredState(node, clock, kind, prefix, self._observe)
        self._markers = node.create_publisher(MarkerArray, f'{prefix}plant_markers', MARKER_DEPTH)
        node.create_timer(1.0 / MARKER_RATE, self._show)
        if f'formation.{name}' in values:
            node.create_subscription(PoseStamped, f'{prefix}goal_pose', self._on_goal, 10)

    def values_changed(self, values: Values) -> None:
        """Draw the plant as the parameters have it, unless they contradict each other."""
        self._values = values
        with suppress(InvalidProblem):
            drawn = self._plant.drawn(values)
            if drawn is not None:
                name, warn = self.prefix.rstrip('/'), self._node.get_logger().warning
                self._picture = self._picture or Picture(drawn, name, warn)
                self._picture.set_up(drawn)

    def seen(self, now: float, max_age: float) -> Observation:
        """Return the newest state and the phase of the tracker; raise NoState as `fresh` does."""
        state, stamp = self.measured.fresh(now, max_age)
        return Observation(state, stamp, self.tracker.phase(now), self.tracker.followed(now))

    def followed_motion(self, plans: PublishedPlans, now: float) -> TimedTrajectory | None:
        """Return the motion of the plant by the plan that its tracker says it follows, if any."""
        plan = plans.starting(self.tracker.followed(now))
        if plan is None:
            return None
        motion = plan.motion(self.name)
        known = motion.trajectory.state_names == self._plant.kind.state_names
        return motion if known else None

    def predicted(self, values: Values, now: float, start: float, plans: PublishedPlans) -> Array:
        """
        Return the state (nx,) at the instant `start`, measured not long before `now`.

        A plant that follows one of the `plans`, within the tracking tolerance, is predicted along
        it, plus the rest of its deviation. Any other plant is predicted without control.

        Raise InvalidProblem or NoState if a state is missing, too old, or cannot be predicted.
        """
        state, measured = self.measured.fresh(now, values['start.max_age'])
        motion, wait = self.followed_motion(plans, now), start - measured
        if motion is not None:
            away = state - motion.reference(measured)
            away[self._angles] = wrapped(away[self._angles])
            if (np.abs(away) <= self._plant.tracking_tolerance(motion.trajectory, values)).all():
                return np.asarray(
                    motion.reference(start) + self._plant.remaining_deviation(away, wait)
                )
        return self._plant.predict_without_plan(state, measured, start, values)

    def _observe(self, state: Array, at: float) -> None:
        self._plant.observe(state, at)
        if self._picture is not None:
            self._picture.add(at, state)

    def _show(self) -> None:
        """Draw a real plant while a viewer subscribes; simulated plants draw themselves."""
        markers, newest = self._markers, self.measured.newest
        if self._picture is None or newest is None or markers.get_subscription_count() == 0:
            return
        old = self._clock.now() - newest[1] > _OLDEST_SHOWN
        if old or self._node.count_publishers(markers.topic_name) > 1:
            return
        now = self._node.get_clock().now().to_msg()
        markers.publish(self._picture.draw(now, newest[0], self.measured.control))

    def _on_goal(self, message: PoseStamped) -> None:
        parameter, anchor = f'formation.{self.name}', self._values['formation.anchor']
        title, at = f"goal_pose of '{self.name}' rejected", message.pose.position
        try:
            check_frame(self._plant.kind, message, 'goal_pose', named=True)
            if not (math.isfinite(at.x) and math.isfinite(at.y)):
                raise InvalidProblem(
                    f"the pose's position is ({at.x:g}, {at.y:g}) m: must be finite numbers"
                )
            pose = at.x, at.y, yaw_of(message.pose.orientation)
        except InvalidProblem as error:
            failure = Failure.of(error)
            self._node.get_logger().warning(f'{title}: {failure}')
            place = self._values.get(parameter) or (0.0, 0.0, 0.0)
            self._tell(place_in_arena(anchor, place), failure)
            return
        changes = {parameter: place_in_formation(anchor, pose)}
        self._request(Request(lambda outcome: self._tell(pose, outcome), changes, True, title))

    def _tell(self, pose: Sequence[float], outcome: str | Failure) -> None:
        """Show for some seconds why there is no plan, or remove the text shown before."""
        pen = Pen(self._plant.kind.frame, lifetime=_NOTICE_TIME)
        marker = pen.marker('rejected', action=Marker.DELETE)
        if isinstance(outcome, Failure):
            text = textwrap.fill(f'{self.name}: {outcome.code}: {outcome.reason}', _LINE)
            marker = pen.text('rejected', text, (pose[0], pose[1], 0.3), _LETTERS)
        self._markers.publish(MarkerArray(markers=[marker]))


class Adapter:
    """
    Gathers the measured states of a problem's plants, and publishes plans for them.

    `values` are those of the planner's parameters; poses given as goals ask for plans by
    `request`. Instants are those of `clock` [s]. Call methods in the executor's thread, except
    where they say otherwise.
    """

    def __init__(
        self,
        node: Node,
        clock: MotionClock,
        problem: type[Problem],
        values: Values,
        request: Callable[[Request], None],
    ) -> None:
        self._node, self._clock, self._problem = node, clock, problem
        self.plans = PublishedPlans()
        self.plant = plant = planned_plant(problem, values)
        self.kind = plant.kind
        names = values['robots'] if plant.several else [plant.vehicle]
        self.vehicles = {n: Vehicle(node, clock, n, plant, values, request) for n in names}
        self._markers = node.create_publisher(MarkerArray, 'markers', LATCHED)
        self._others: dict[str, Any] = {}  # publishers for vehicles that only the solution names
        self.values_changed(values)

    def values_changed(self, values: Values) -> None:
        """Follow changed parameters; an active plan is drawn as it was made."""
        for vehicle in self.vehicles.values():
            vehicle.values_changed(values)
        with suppress(InvalidProblem):
            preview = self.plant.preview(values) if self.plans.newest is None else None
            if preview is not None:
                self._markers.publish(plan_markers(self.kind.frame, *preview))

    # The state.

    def missing(self) -> list[str]:
        """Return a sentence for every topic on which no state was received yet. Any thread."""
        return [v.label + text for v in self.vehicles.values() for text in v.measured.missing]

    def measured_start(self, values: Values, now: float, start: float) -> dict[str, Any]:
        """
        Return the start.* parameters that the measured state gives for the instant `start`.

        `values` are the parameters of the request. Called in the worker's thread.

        A plant that its tracker brings to rest is predicted as reviews predict it.

        Raise InvalidProblem or NoState as `Vehicle.predicted` does.
        """
        plan, plant, oldest = self.plans.newest, self.plant, values['start.max_age']
        states = self.of_all(lambda v: v.predicted(values, now, start, self.plans))
        if plan is not None and not plant.rests_before_start:
            seen = self.of_all(lambda v: v.seen(now, oldest))
            if braked := [n for n, one in seen.items() if one.phase is ObservedPhase.RECOVERING]:
                trackers = {name: v.tracker.parameters for name, v in self.vehicles.items()}
                moved = plant.execution(plan, trackers, values).predict(seen, start)
                states |= {name: moved[name].state for name in braked}
        return self._starts(states)

    def pending_start(self, now: float) -> float | None:
        """Return when the newest plan begins [s], if after `now`, and if a tracker awaits it."""
        plan, plans = self.plans.newest, self.plans
        if plan is None or plan.start <= now:
            return None
        then, vehicles = plan.start + SAME_START, self.vehicles.values()
        awaited = any(plans.starting(v.tracker.followed(then)) is plan for v in vehicles)
        return plan.start if awaited else None

    def may_start_later(self, now: float, start: float) -> bool:
        """
        Whether the `start` [s] can be put off: of a stated plant that follows no plan.

        It cannot while it lies ahead if the plant moves: it would be elsewhere.
        """
        vehicles = self.vehicles.values()
        motions = [v.followed_motion(self.plans, now) for v in vehicles]
        over = all(motion is None or motion.end <= now for motion in motions)
        ahead = self.plant.moves and self._clock.now() < start
        return self.plant.rests_before_start and over and not ahead

    def of_all(self, ask: Callable[[Vehicle], T]) -> dict[str, T]:
        """Return the answers of all vehicles; NoState names all that are missing."""
        found, missing = {}, []
        for name, vehicle in self.vehicles.items():
            try:
                found[name] = ask(vehicle)
            except NoState as error:
                missing.append(f'{vehicle.label}{error}')
        if missing:
            raise NoState('; '.join(missing))
        return found

    def _starts(self, states: Mapping[str, Array]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, state in states.items():
            found |= zip(self.vehicles[name].start_parameters, state.tolist(), strict=True)
        return found

    # Plans.

    def publish(self, plan: TimedPlan, stamp: int) -> None:
        """Publish a plan whose motion starts at the instant `stamp` [ns], and draw it."""
        motions, several = plan.solution.trajectories, self.plant.several
        only = next(iter(self.vehicles.values())) if len(motions) == 1 else None
        views = {name: view_of(plan.problem, motion) for name, motion in motions.items()}
        for name, trajectory in motions.items():
            kind = views[name].kind
            extra = self.plant.extra_joints(plan.problem, trajectory)
            message = plan_message(kind, trajectory, to_stamp(stamp), extra)
            vehicle = self.vehicles.get(name, only)
            if vehicle is not None:
                vehicle.trajectory.publish(message)
                if vehicle.path is not None:
                    vehicle.path.publish(path_message(kind, trajectory, stamp))
                continue
            if name not in self._others:
                topic = f'{name}/trajectory'
                made = self._node.create_publisher(JointTrajectory, topic, LATCHED)
                self._others[name] = made
            self._others[name].publish(message)
        self.plans.add(plan)
        view = next(iter(views.values()))
        ways = [DrawnPath(view, m.states, name if several else '') for name, m in motions.items()]
        try:
            self._markers.publish(plan_markers(view.kind.frame, view.surroundings, ways))
        except InvalidProblem as error:  # markers must not cost the plan
            self._node.get_logger().warning(str(error))

    def forget_plans(self) -> None:
        """Forget the plans: simulated time was set back, and the trackers have dropped them."""
        self.plans = PublishedPlans()
        self.withdraw()
        for vehicle in self.vehicles.values():
            vehicle.tracker.forget_plans()

    def withdraw(self) -> None:
        """Latch no plan: a tracker started after the clock was set back would begin it anew."""
        empty = JointTrajectory()
        # A stamp of zero means that it begins when it comes.
        empty.header.stamp = to_stamp(max(1, self._node.get_clock().now().nanoseconds))
        for publisher in (*(v.trajectory for v in self.vehicles.values()), *self._others.values()):
            publisher.publish(empty)

    def recovered(
        self, values: Values, trajectories: Mapping[str, Trajectory], stamp: int
    ) -> TimedPlan:
        """
        Rebuild the active plan from the trajectories that trackers report.

        They begin at `stamp` [ns]; `values` are the parameters of the problem.

        Called in the worker's thread. Raise TdmError if they are no plan of such a problem.
        """
        starts = self._starts({name: t.states[0] for name, t in trajectories.items()})
        problem = self._problem.from_parameters({**values, **starts})
        solution = problem.recovered(trajectories)
        return TimedPlan(problem, solution, self._clock.instant(stamp))

    def warnings(self) -> list[str]:
        """Return a sentence for every plant or tracker of several that is not connected."""
        found = []
        for v in self.vehicles.values() if self.plant.several else ():
            if v.trajectory.get_subscription_count() == 0:
                found.append(f'{v.label}no tracker listens to {v.trajectory.topic_name}')
            if self._node.count_publishers(v.measured.topic) == 0:
                found.append(f'{v.label}no plant publishes {v.measured.topic}')
        return found

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The plants that the page shows: their problem, states and plan, and what the plots hold."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from tdm_planner.arrays import Array
from tdm_planner.client import PlanResult
from tdm_planner.drawing import COLOURS, rgb
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of, read_joints, read_odometry
from tdm_planner.plant_kind import PENDULUM, PlantKind
from tdm_planner.plant_views import PlantView, view_of
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.trajectory import NANOSECOND, Sample, TimedTrajectory, Trajectory
from tdm_sim.live.geometry import Colour
from tdm_sim.live.listener import Listener
from tdm_sim.report.margins import margins_of

SPAN = 12.0  # s that are shown
RATE = 25.0  # Hz of what is remembered
MARGINS = 'margins of the limits'
SOLVING = 'time to solve [ms]'

_KEPT = 60  # plans whose time to solve is shown
_LAST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Motion(NamedTuple):
    """A vehicle's newest state (nx,), the controls (nu,) that act, and their instant [ns]."""

    state: Array
    control: Array
    instant: int


class WatchedVehicle:
    """
    The state of one vehicle in the namespace `prefix`, '' or 'robot1/', of its planner.

    A callback for every state would cost more than the page does: the newest one is taken when it
    is asked for.
    """

    def __init__(self, node: rclpy.node.Node, kind: PlantKind, prefix: str) -> None:
        self._kind = kind

        def subscribed(message: type, topic: str) -> Any:
            return node.create_subscription(message, f'{prefix}{topic}', lambda _: None, _LAST)

        states = partial(read_joints, kind.measured, names=kind.state_names)
        efforts = [partial(read_joints, [j], names=kind.control_names) for j in kind.actuated]
        self._readers = [(subscribed(JointState, 'joint_states'), [states, *efforts])]
        if kind.odometry:
            self._readers.append((subscribed(Odometry, 'odom'), [partial(read_odometry, kind)]))
        self._values: dict[str, float] = dict.fromkeys(kind.control_names, 0.0)
        self._instant = 0

    def newest(self) -> Motion | None:
        """Return what is known of the motion; None until the state is complete."""
        kind = self._kind
        for subscription, readers in self._readers:
            message = _newest(subscription)
            for read in readers if message is not None else ():
                with suppress(InvalidProblem):  # others may publish here; not all tell of efforts
                    self._values |= read(message)
                    self._instant = nanoseconds_of(message.header.stamp)
        if any(name not in self._values for name in kind.state_names):
            return None
        return Motion(
            np.array([self._values[name] for name in kind.state_names]),
            np.array([self._values[name] for name in kind.control_names]),
            self._instant,
        )


def _newest(subscription: Any) -> Any:
    """Take the last message that has come; None where there is no new one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, False)
    return None if taken is None else taken[0]


class Rig:
    """Problem, vehicles and their motions, and the plan; nothing until `follow` was called."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self.problem: Problem | None = None
        self.view = PlantView(PENDULUM)
        self.vehicles: dict[str, WatchedVehicle] = {}
        self.motions: dict[str, Motion] = {}
        self.plan: PlanResult | None = None
        self.chosen = ''

    def follow(self, values: Mapping[str, Any]) -> bool:
        """
        Take over the planner's parameters; returns whether there are other vehicles now.

        Raise InvalidProblem if they state no problem.
        """
        kind = load_problem(values['problem'])
        known = kind.parameter_specifications(values)
        problem = kind.from_parameters({name: values.get(name) for name in known})
        view, several = view_of(problem), isinstance(problem, RobotFormation)
        names = list(problem.robots) if isinstance(problem, RobotFormation) else [view.name]
        others = self.problem is None or self.view.kind != view.kind
        others |= names != list(self.vehicles)
        if others:
            self.vehicles = {
                name: WatchedVehicle(
                    self._listener.states, view.kind, f'{name}/' if several else ''
                )
                for name in names
            }
            self.chosen, self.plan, self.motions = names[0], None, {}
        self.problem, self.view = problem, view
        return others

    def move(self) -> bool:
        """Update the newest states and the newest plan; returns whether the plan has changed."""
        news = {name: vehicle.newest() for name, vehicle in self.vehicles.items()}
        self.motions = {name: motion for name, motion in news.items() if motion is not None}
        before, self.plan = self.plan, self._listener.client.newest
        return self.plan is not before

    def colour(self, name: str) -> Colour | None:
        """Return the colour of a vehicle; None where there is only one."""
        if len(self.vehicles) == 1:
            return None
        return rgb(COLOURS[list(self.vehicles).index(name) % len(COLOURS)])

    def planned(self, name: str) -> TimedTrajectory | None:
        """Return what is planned for a vehicle, by instants [s] of the nodes' clock."""
        if self.plan is None:
            return None
        planned = self.plan.trajectories
        own = planned.get(name) if len(self.vehicles) > 1 else next(iter(planned.values()))
        return None if own is None else TimedTrajectory(own, self.plan.start * NANOSECOND)


class Chart(NamedTuple):
    """Curves over the same instants, and planned ones, by name."""

    title: str
    x: Array
    curves: Mapping[str, Array]
    planned: Mapping[str, Array] = {}


class History:
    """Recent states and controls of a vehicle by instants [s]; begins anew with simulated time."""

    def __init__(self, view: PlantView) -> None:
        self.view = view
        self._rows: deque[tuple[float, Array, Array]] = deque(maxlen=round(SPAN * RATE))

    def add(self, instant: float, state: Array, control: Array) -> None:
        """Remember a state (nx,) and controls (nu,), unless the last one is too recent."""
        rows = self._rows
        if rows and instant < rows[-1][0]:
            rows.clear()
        if not rows or instant - rows[-1][0] > 0.8 / RATE:
            rows.append((instant, state, control))

    def charts(self, plan: TimedTrajectory | None) -> list[Chart]:
        """Return charts by unit, and one of margins; without a plan, as if it were followed."""
        if len(self._rows) < 2:
            return []
        kind, units = self.view.kind, self.view.units
        times = np.array([row[0] for row in self._rows])
        states, controls = (np.array([row[k] for row in self._rows]) for k in (1, 2))
        planned = Sample(states, controls) if plan is None else plan.sample(times)
        charts: list[Chart] = []
        for names, values, wanted in (
            (kind.state_names, states, planned.state),
            (kind.control_names, controls, planned.control),
        ):
            for title, columns in _by_unit(names, units):
                shown = ({names[k]: v[:, k] for k in columns} for v in (values, wanted))
                charts.append(Chart(title, times - times[-1], *shown))
        if plan is not None:
            curves = self._margins(plan.trajectory, times - plan.start, states, controls)
            if curves:
                charts.append(Chart(MARGINS, times - times[-1], curves))
        return charts

    def _margins(
        self, plan: Trajectory, times: Array, states: Array, controls: Array
    ) -> dict[str, Array]:
        """Return what is left to every limit, as a share of the most in what is shown."""
        found = margins_of(self.view.constraints(plan), times, times, states, controls)
        return {
            name: left / max(float(np.abs(left).max()), 1e-12)
            for name, left in zip(found.names, found.values.T, strict=True)
            if np.isfinite(left).all()
        }


def _by_unit(names: Sequence[str], units: dict[str, str]) -> list[tuple[str, list[int]]]:
    """Return which of some names share a unit, with a title."""
    groups: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        groups.setdefault(units.get(name, ''), []).append(k)
    return [
        (', '.join(names[k] for k in found) + (f' [{unit}]' if unit else ''), found)
        for unit, found in groups.items()
    ]


class SolveTimes:
    """How long the last plans took to solve."""

    def __init__(self) -> None:
        self._known: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def add(self, plan_id: int, solve_time: float) -> None:
        """Remember a plan; a planner that begins to count anew begins anew."""
        if self._known and plan_id < self._known[-1][0]:
            self._known.clear()
        if not self._known or plan_id != self._known[-1][0]:
            self._known.append((plan_id, solve_time))

    def chart(self) -> Chart | None:
        """Return the time to solve [ms] over the number of the plan."""
        if len(self._known) < 2:
            return None
        x, y = np.array(self._known, dtype=float).T
        return Chart(SOLVING, x, {'time to solve': 1e3 * y})

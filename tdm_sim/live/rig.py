# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The plants that the page shows: their problem, states and plan, and what the plots hold."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tdm_planner.arrays import Array
from tdm_planner.client import PlanResult
from tdm_planner.drawing import COLOURS, rgb
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.plant_views import PlantView, view_of
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.trajectory import NANOSECOND, Sample, TimedTrajectory, Trajectory
from tdm_sim.live.geometry import Colour
from tdm_sim.live.listener import Listener
from tdm_sim.report.signals import margins_of

SPAN = 12.0  # s that are shown
RATE = 25.0  # Hz of what is remembered
MARGINS = 'margins of the limits'
SOLVING = 'time to solve [ms]'

_SOLVE_TIMES_KEPT = 60  # plans whose time to solve is remembered
_LAST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Motion(NamedTuple):
    """A vehicle's newest state (nx,), the controls (nu,) that act, and their instant [ns]."""

    state: Array
    control: Array
    instant: int


class Rig:
    """Problem, vehicles and their motions, and the plan; nothing until `follow` was called."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._clock = MotionClock(listener.states)
        self.problem: Problem | None = None
        self.view = PlantView(PENDULUM)
        self.vehicles: dict[str, MeasuredState] = {}
        self.motions: dict[str, Motion] = {}
        self.plan: PlanResult | None = None
        self.solve_times: deque[float] = deque(maxlen=_SOLVE_TIMES_KEPT)  # of the last plans [s]
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
            for state in self.vehicles.values():
                state.close()
            self.vehicles = {
                name: MeasuredState(
                    self._listener.states,
                    self._clock,
                    view.kind,
                    f'{name}/' if several else '',
                    lambda *_: None,
                    qos=_LAST,
                )
                for name in names
            }
            self.chosen, self.plan, self.motions = names[0], None, {}
        self.problem, self.view = problem, view
        return others

    def measure(self) -> None:
        """
        Update the newest states: of vehicles whose state is complete.

        A callback for every state would cost more than the page does: the last ones are taken.
        """
        for subscription in self._listener.states.subscriptions:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, False)
            if taken is not None:
                subscription.callback(taken[0])
        self.motions = {
            name: Motion(newest[0], vehicle.control, self._clock.stamp(newest[1]))
            for name, vehicle in self.vehicles.items()
            if (newest := vehicle.newest) is not None
        }

    def move(self) -> bool:
        """Update the newest states and the newest plan; returns whether the plan has changed."""
        self.measure()
        before, self.plan = self.plan, self._listener.client.newest
        states = set(self.view.kind.state_names)
        if self.plan and any(states - {*m.state_names} for m in self.plan.trajectories.values()):
            self.plan = None  # of another plant, whose nodes ran here before
        if self.plan is not None and self.plan is not before:
            self.solve_times.append(self.plan.solve_time)
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
        kind, units = self.view.kind, self.view.kind.units
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
            for name, left in found.columns.items()
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

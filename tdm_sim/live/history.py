# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The data of the page's plots: the last seconds of one vehicle beside its plan, by unit."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plant_views import PlantView
from tdm_planner.trajectory import Sample, TimedTrajectory, Trajectory
from tdm_planner.verification import Constraint

Array = NDArray[np.float64]

SPAN = 12.0  # s that are shown
RATE = 25.0  # Hz of what is remembered
MARGINS = 'margins of the limits'
SOLVING = 'time to solve [ms]'

_KEPT = 60  # plans whose time to solve is shown


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over the same instants: `curves` by label, planned ones are dashed."""

    title: str
    x: Array
    curves: dict[str, Array]
    planned: frozenset[str] = frozenset()


class History:
    """
    Recent states and controls of one vehicle, by instants [s] of the nodes' clock.

    `view` says what its limits are. An instant before the last one (simulated time began anew)
    begins a new history.
    """

    def __init__(self, view: PlantView) -> None:
        self.view = view
        self._rows: deque[tuple[float, Array, Array]] = deque(maxlen=round(SPAN * RATE))
        self._limits: tuple[object, Sequence[Constraint]] = None, ()

    def add(self, instant: float, state: Array, control: Array) -> None:
        """Remember a state (nx,) and controls (nu,), unless the last one is too recent."""
        rows = self._rows
        if rows and instant < rows[-1][0]:
            rows.clear()
        if not rows or instant - rows[-1][0] > 0.8 / RATE:
            rows.append((instant, state, control))

    def charts(self, plan: TimedTrajectory | None) -> list[Chart]:
        """
        Return a chart for every unit of states and controls, and one of the margins.

        Curves are the same ones always: without a plan, planned ones lie on the measured ones.
        """
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
                curves = {names[k]: values[:, k] for k in columns}
                dashed = {_planned(names[k]): wanted[:, k] for k in columns}
                charts.append(Chart(title, times - times[-1], curves | dashed, frozenset(dashed)))
        if plan is not None:
            curves = self._margins(plan.trajectory, times - plan.start, states, controls)
            if curves:
                charts.append(Chart(MARGINS, times - times[-1], curves))
        return charts

    def _margins(
        self, plan: Trajectory, times: Array, states: Array, controls: Array
    ) -> dict[str, Array]:
        """Return what is left to every limit, as a share of the most in what is shown."""
        of = plan, self.view
        if self._limits[0] != of:
            self._limits = of, self.view.constraints(plan)
        found = {}
        for limit in self._limits[1]:
            with np.errstate(all='ignore'):
                left = np.asarray(limit.margin(times, states, controls), dtype=float)
            if left.shape == times.shape and np.isfinite(left).all():
                found[limit.name] = left / max(float(np.abs(left).max()), 1e-12)
        return found


def _planned(name: str) -> str:
    return f'{name}, planned'


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

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

"""Time histories of a plan, and of what was measured along it, as PNG, PDF or SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from tdm_planner.palette import LIMIT, MEASURED, PLANNED, SWITCH
from tdm_planner.plan_margins import plan_margins, PlanMargin
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.pendulum_swing_up import PendulumSwingUp
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

TIME_LABEL = 'time from the start of the motion [s]'


@dataclass(frozen=True)
class Measurement:
    """What was measured: times (n,) s from the start of the motion, columns by name (n,)."""

    times: Array
    columns: dict[str, Array]


def plot_solution(problem: Problem, solution: Solution, path: Path) -> None:
    """Write the time histories of a solution, with the problem's limits, to `path`."""
    if len(solution.trajectories) == 1:
        limits = plot_limits(problem)
        margins = plan_margins(problem, solution.trajectory)
        figure = plot_trajectory(
            solution.trajectory,
            limits,
            title=solution.summary,
            margins=margins,
            upright='theta' if isinstance(problem, PendulumSwingUp) else '',
        )
    else:
        from tdm_planner.formation_plot import FormationView, plot_formation

        view = FormationView.of(problem)
        figure = plot_formation(
            view,
            solution.trajectories,
            title=solution.summary,
            margins={
                name: plan_margins(problem, trajectory)
                for name, trajectory in solution.trajectories.items()
            },
        )
    figure.savefig(path, dpi=110)


def plot_limits(problem: Problem) -> dict[str, float]:
    """Return the symmetric limits of states and controls that a problem declares, by name."""
    group = getattr(problem, 'limits', None)
    declared = {
        column: getattr(group, name, None)
        for column, name in {'torque': 'torque', 'psi': 'disk_angle'}.items()
    }
    return {column: float(value) for column, value in declared.items() if value is not None}


def plot_trajectory(
    trajectory: Trajectory,
    limits: dict[str, float],
    measured: Measurement | None = None,
    title: str = '',
    margins: Sequence[PlanMargin] = (),
    upright: str = '',
) -> Figure:
    """
    Draw every state, control and margin over time; planned and measured, limits, switches.

    `upright` names the state that is a pendulum's angle from upright, '' if there is none.
    """
    columns = [*trajectory.state_names, *trajectory.control_names]
    units = [*trajectory.state_units, *trajectory.control_units] or [''] * len(columns)
    rows = len(columns) + len(margins)
    figure = Figure(figsize=(9, 1.6 * rows + 1.0), layout='constrained')
    axes: list[Axes] = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0].tolist()
    switches = switching_instants(trajectory)
    for axis, name, unit in zip(axes, columns, units, strict=False):
        if measured is not None and name in measured.columns:
            axis.plot(
                measured.times,
                measured.columns[name],
                color=MEASURED,
                lw=3,
                alpha=0.5,
                label='measured',
            )
        draw_planned(axis, trajectory, name, PLANNED, 'planned')
        if name in limits:
            draw_limits(axis, -limits[name], limits[name])
        if name == upright:
            _label_upright(axis, trajectory.state(name))
        label_quantity(axis, name, unit)
    first = len(columns)
    for axis, margin in zip(axes[first:], margins, strict=True):
        axis.plot(margin.times, margin.values, color=PLANNED)
        draw_limits(axis, 0.0)
        label_quantity(axis, f'margin of\n{margin.name}', margin.unit)
    for axis in axes:
        for instant in switches:
            axis.axvline(instant, color=SWITCH, lw=0.7, ls=':')
    _explain(axes, switches)
    axes[-1].set_xlabel(TIME_LABEL)
    if title:
        figure.suptitle(title, fontsize='medium', wrap=True)
    return figure


def switching_instants(trajectory: Trajectory) -> Array:
    """Return the instants at which a held control jumps [s]."""
    if trajectory.interpolation != 'zero_order_hold':
        return np.zeros(0)
    jumps = (np.diff(trajectory.controls[:-1], axis=0) != 0).any(axis=1)
    instants: Array = trajectory.times[1:-1][jumps]
    return instants


def draw_planned(
    axis: Axes, trajectory: Trajectory, name: str, colour: str, label: str = ''
) -> None:
    """Draw a state or a control as it runs between its samples."""
    if name in trajectory.state_names:
        axis.plot(trajectory.times, trajectory.state(name), color=colour, label=label)
    elif trajectory.interpolation == 'zero_order_hold':
        axis.step(
            trajectory.times, trajectory.control(name), where='post', color=colour, label=label
        )
    else:
        axis.plot(trajectory.times, trajectory.control(name), color=colour, label=label)


def draw_limits(axis: Axes, *levels: float) -> None:
    """Draw what a quantity must not pass."""
    for level in levels:
        axis.axhline(level, color=LIMIT, lw=1, ls='--')


def label_quantity(axis: Axes, name: str, unit: str) -> None:
    """Name a quantity beside its axis, with a grid to read it by."""
    axis.set_ylabel(f'{name} [{unit}]' if unit else name)
    axis.grid(alpha=0.25)


def _explain(axes: Sequence[Axes], switches: Array) -> None:
    """Put a legend above the first panel, of what there is."""
    handles, labels = axes[0].get_legend_handles_labels()
    limited = [line for axis in axes for line in axis.get_lines() if line.get_color() == LIMIT]
    switched = [line for line in axes[0].get_lines() if line.get_color() == SWITCH]
    if limited:
        handles, labels = [*handles, limited[0]], [*labels, 'limits']
    if switches.size:
        handles, labels = [*handles, switched[-1]], [*labels, 'switching points']
    axes[0].legend(
        handles,
        labels,
        loc='lower right',
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(handles),
        fontsize='small',
        frameon=False,
    )


def _label_upright(axis: Axes, angles: Array) -> None:
    """Mark the upright position that angles (n,) from upright end near."""
    upright = 2 * math.pi * round(float(angles[-1]) / (2 * math.pi))
    axis.axhline(upright, color='0.5', lw=1)
    rising = bool(angles[0] < upright)
    axis.annotate(
        'upright',
        (0.005, upright),
        xycoords=axis.get_yaxis_transform(),
        xytext=(0, -3 if rising else 3),
        textcoords='offset points',
        va='top' if rising else 'bottom',
        fontsize='small',
    )

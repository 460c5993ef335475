# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Time histories of a plan, and of what was measured along it, as PNG, PDF or SVG."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from tdm_planner.problems.base import Problem, Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

PLANNED, MEASURED, LIMIT, SWITCH = '#1f4e9c', '#d1670a', '#b3261e', '#9aa0a6'


@dataclass(frozen=True)
class Measurement:
    """What was measured: times (n,) s from the start of the motion, columns by name (n,)."""

    times: Array
    columns: dict[str, Array]


def plot_solution(problem: Problem, solution: Solution, path: Path) -> None:
    """Write the time histories of a solution, with the problem's limits, to `path`."""
    limits = plot_limits(problem)
    if len(solution.trajectories) == 1:
        figure = plot_trajectory(solution.trajectory, limits, title=solution.summary)
    else:
        from tdm_planner.formation_plot import FormationView, plot_formation

        view = FormationView.of(problem)
        figure = plot_formation(view, solution.trajectories, title=solution.summary)
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
) -> Figure:
    """Draw every state and control over time, planned and measured, limits and switches."""
    columns = [*trajectory.state_names, *trajectory.control_names]
    units = [*trajectory.state_units, *trajectory.control_units] or [''] * len(columns)
    figure = Figure(figsize=(9, 1.75 * len(columns) + 1.0), layout='constrained')
    axes = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    switches = switching_instants(trajectory)
    for axis, name, unit in zip(axes, columns, units, strict=True):
        if measured is not None and name in measured.columns:
            axis.plot(
                measured.times, measured.columns[name], color=MEASURED, lw=1, label='measured'
            )
        _draw_planned(axis, trajectory, name)
        if name in limits:
            for sign in (-1, 1):
                axis.axhline(sign * limits[name], color=LIMIT, lw=1, ls='--')
        for instant in switches:
            axis.axvline(instant, color=SWITCH, lw=0.7, ls=':')
        _label_turns(axis, trajectory, name)
        axis.set_ylabel(f'{name} [{unit}]' if unit else name)
        axis.grid(alpha=0.25)
    axes[0].legend(loc='upper right', fontsize='small')
    axes[-1].set_xlabel('time from the start of the motion [s]')
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


def _draw_planned(axis: Axes, trajectory: Trajectory, name: str) -> None:
    held = trajectory.interpolation == 'zero_order_hold'
    if name in trajectory.control_names and held:
        axis.step(
            trajectory.times,
            trajectory.control(name),
            where='post',
            color=PLANNED,
            label='planned',
        )
    elif name in trajectory.control_names:
        axis.plot(trajectory.times, trajectory.control(name), color=PLANNED, label='planned')
    else:
        axis.plot(trajectory.times, trajectory.state(name), color=PLANNED, label='planned')


def _label_turns(axis: Axes, trajectory: Trajectory, name: str) -> None:
    """Mark upright on the axis of the pendulum angle."""
    if name == 'theta':
        upright = 2 * math.pi * round(float(trajectory.states[-1, 0]) / (2 * math.pi))
        axis.axhline(upright, color=SWITCH, lw=1)
        below = 'top' if trajectory.states[0, 0] < upright else 'bottom'
        axis.annotate('upright', (0.005, upright), xycoords=('axes fraction', 'data'), va=below)

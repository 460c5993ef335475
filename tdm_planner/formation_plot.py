# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A formation plan as a picture: the arena from above, controls and distances over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import itertools

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
import numpy as np
from numpy.typing import NDArray

from tdm_planner.measured_robot import MeasuredRobot, pair_distance
from tdm_planner.problems.base import Problem
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

LIMIT = '#b3261e'
_BODIES = 9  # instants at which the bodies are drawn


@dataclass(frozen=True, eq=False)
class FormationView:
    """What of the problem is drawn: arena, keep-out zones (k, 3), separation, limits by name."""

    length: float
    width: float
    separation: float
    obstacles: Array
    limits: Mapping[str, float]

    @classmethod
    def of(cls, problem: Problem) -> FormationView:
        """Return the view of a formation problem."""
        assert isinstance(problem, RobotFormation)
        arena, limits = problem.arena, problem.limits
        return cls(
            length=arena.length,
            width=arena.width,
            separation=arena.minimum_separation,
            obstacles=np.array(arena.obstacles, dtype=float).reshape(-1, 3),
            limits={
                'thrust': limits.thrust,
                'thruster_rate': limits.thruster_rate,
                'torque': limits.torque,
            },
        )


def plot_formation(
    view: FormationView,
    plans: Mapping[str, Trajectory],
    measured: Mapping[str, MeasuredRobot] | None = None,
    title: str = '',
) -> Figure:
    """Draw plans of several robots, and what was measured along them."""
    measured = measured or {}
    figure = Figure(figsize=(14, 9), layout='constrained')
    halves = figure.subfigures(1, 2, width_ratios=[1.15, 1])
    assert isinstance(halves, np.ndarray)
    left, right = halves
    arena = left.subplots()
    _draw_arena(arena, view)
    names = list(plans)
    colours = dict(zip(names, colormaps['tab10'](np.arange(len(names)) % 10), strict=True))
    end = max(plan.duration for plan in plans.values())
    for name, plan in plans.items():
        _draw_robot(arena, view, name, plan, colours[name], np.linspace(0.0, end, _BODIES))
        if name in measured:
            columns = measured[name].columns
            arena.plot(columns['x'], columns['y'], color=colours[name], lw=1, ls=':')
    arena.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=6, fontsize='small')
    rows = right.subplots(4, 1, sharex=True)
    for axis, (control, unit) in zip(
        rows, {'thrust': 'N', 'thruster_rate': 'rad/s', 'torque': 'N m'}.items(), strict=False
    ):
        _draw_control(axis, control, unit, view, plans, measured, colours)
    _draw_distances(rows[3], view, plans, measured)
    rows[3].set_xlabel('time from the start of the motion [s]')
    if title:
        figure.suptitle(title)
    return figure


def _draw_arena(axis: Axes, view: FormationView) -> None:
    axis.add_patch(Rectangle((0, 0), view.length, view.width, fill=False, ec='0.3', lw=2))
    inset = view.separation / 2
    axis.add_patch(
        Rectangle(
            (inset, inset),
            view.length - 2 * inset,
            view.width - 2 * inset,
            fill=False,
            ec=LIMIT,
            ls='--',
            lw=0.8,
        )
    )
    for x, y, radius in view.obstacles.tolist():
        axis.add_patch(Circle((x, y), radius, fc='0.8', ec=LIMIT))
    axis.set_aspect('equal')
    axis.set_xlim(-0.1, view.length + 0.1)
    axis.set_ylim(-0.1, view.width + 0.1)
    axis.set_xlabel('x [m]')
    axis.set_ylabel('y [m]')


def _draw_robot(
    axis: Axes, view: FormationView, name: str, plan: Trajectory, colour: Array, instants: Array
) -> None:
    """Path, bodies with heading at the instants, and arrows where there is thrust."""
    axis.plot(plan.state('x'), plan.state('y'), color=colour, label=name)
    state, control = plan.sample(instants)
    moving = instants <= plan.duration
    radius = view.separation / 2
    for k, (x, y, _, _, yaw, _, _) in enumerate(state.tolist()):
        faint = 0.15 + 0.5 * k / len(instants)
        axis.add_patch(Circle((x, y), radius, fc='none', ec=colour, alpha=faint))
        heading = [x, x + radius * np.cos(yaw)], [y, y + radius * np.sin(yaw)]
        axis.plot(*heading, color=colour, alpha=faint)
    push = control[:, 0] * moving / view.limits['thrust']
    direction = state[:, 4] + state[:, 6]
    axis.quiver(
        state[:, 0],
        state[:, 1],
        push * np.cos(direction),
        push * np.sin(direction),
        color=colour,
        angles='xy',
        scale_units='xy',
        scale=2.0,
        width=0.004,
    )


def _draw_control(
    axis: Axes,
    control: str,
    unit: str,
    view: FormationView,
    plans: Mapping[str, Trajectory],
    measured: Mapping[str, MeasuredRobot],
    colours: Mapping[str, Array],
) -> None:
    for name, plan in plans.items():
        axis.plot(plan.times, plan.control(control), color=colours[name])
        if name in measured and control in measured[name].columns:
            seen = measured[name]
            axis.plot(seen.times, seen.columns[control], color=colours[name], lw=0.8, ls=':')
    limit = view.limits[control]
    for value in (limit,) if control == 'thrust' else (-limit, limit):
        axis.axhline(value, color=LIMIT, ls='--', lw=1)
    axis.set_ylabel(f'{control} [{unit}]')
    axis.grid(alpha=0.25)


def _draw_distances(
    axis: Axes,
    view: FormationView,
    plans: Mapping[str, Trajectory],
    measured: Mapping[str, MeasuredRobot],
) -> None:
    end = max(plan.duration for plan in plans.values())
    times = np.linspace(0.0, end, 600)
    paths = {name: plan.sample(times).state[:, :2] for name, plan in plans.items()}
    for k, (one, other) in enumerate(itertools.combinations(plans, 2)):
        colour = colormaps['Dark2'](k % 8)
        distance = np.linalg.norm(paths[one] - paths[other], axis=1)
        axis.plot(times, distance, color=colour, label=f'{one} - {other}')
        if one in measured and other in measured:
            at, seen = pair_distance(measured[one], measured[other])
            axis.plot(at, seen, color=colour, lw=0.8, ls=':')
    axis.axhline(view.separation, color=LIMIT, ls='--', lw=1)
    axis.set_ylabel('distance [m]')
    axis.set_ylim(bottom=0.0)
    axis.grid(alpha=0.25)
    if len(plans) <= 4:
        axis.legend(fontsize='x-small', loc='upper right')

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A plan as a picture: the plants' way, and every quantity over time; PNG, PDF or SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import itertools
from pathlib import Path
from typing import NamedTuple

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.drawing import (
    COLOURS,
    Disc,
    LIMIT,
    points_of,
    Shape,
    STYLE_COLOURS,
    SWITCH,
    way_of,
)
from tdm_planner.plant_views import PlantView, view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import dense_times

Plans = Mapping[str, Trajectory]

TIME_LABEL = 'time from the start of the motion [s]'

_INSTANTS = 1000  # of margins and ways
_BODIES = 9  # instants at which the plants are drawn
_FEW = 4  # pairs of vehicles that a legend names
_COLOURS = {'limit': LIMIT, 'reach': SWITCH, 'force': STYLE_COLOURS['force']}


class PlanMargin(NamedTuple):
    """Margin of a constraint at `times` (n,) s, `values` (n,): negative where it is violated."""

    name: str
    unit: str
    times: Array
    values: Array


def plan_margins(problem: Problem, trajectory: Trajectory) -> tuple[PlanMargin, ...]:
    """Return the margin of every constraint that the problem puts on one vehicle's motion."""
    times = dense_times(trajectory, trajectory.duration / _INSTANTS)
    states, controls = trajectory.sample(times)
    return tuple(
        PlanMargin(c.name, c.unit, times, np.asarray(c.margin(times, states, controls)))
        for c in problem.constraints_on(trajectory)
    )


def plot_solution(problem: Problem, solution: Solution, path: Path) -> None:
    """Write the picture of a solution, with the problem's limits, to `path`."""
    plot_plans(problem, solution.trajectories, solution.summary).savefig(path, dpi=110)


def plot_plans(problem: Problem, plans: Plans, title: str = '') -> Figure:
    """Draw states, controls, margins and, of plants in the plane, their ways and distances."""
    first = next(iter(plans.values()))
    view = view_of(problem, first)
    margins = {name: plan_margins(problem, plan) for name, plan in plans.items()}
    named = {m.name for found in margins.values() for m in found}
    rows = len(first.state_names) + len(first.control_names) + len(named)
    shapes = _drawn(view, first, np.zeros(1))
    if not shapes or points_of(shapes[0], 1).shape[-1] > 2:
        figure = Figure(figsize=(9, 1.6 * rows + 1.0), layout='constrained')
        names = [*first.state_names, *first.control_names]
        _histories(figure, view, plans, names, margins)
    else:
        figure = Figure(figsize=(18, 11.5), layout='constrained')
        thirds = figure.subfigures(1, 3, width_ratios=[1.3, 1, 1])
        assert isinstance(thirds, np.ndarray)
        _picture(thirds[0], view, plans)
        _histories(thirds[1], view, plans, first.state_names, {})
        _histories(thirds[2], view, plans, first.control_names, margins)
    if title:
        figure.suptitle(title, fontsize='medium', wrap=True)
    return figure


def _coloured(plans: Plans) -> dict[str, str]:
    return {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(plans)}


def _histories(
    part: Figure | SubFigure,
    view: PlantView,
    plans: Plans,
    names: Sequence[str],
    margins: Mapping[str, Sequence[PlanMargin]],
) -> None:
    kept = {m.name: m.unit for found in margins.values() for m in found}
    axes = part.subplots(len(names) + len(kept), 1, sharex=True, squeeze=False)[:, 0]
    bounds, colours = view.bounds(), _coloured(plans)
    first = next(iter(plans.values()))
    switches = first.times[first.switches] if len(plans) == 1 else ()
    for axis, name in zip(axes, names, strict=False):
        for vehicle, plan in plans.items():
            held = plan.interpolation == 'zero_order_hold' and name in plan.control_names
            style = 'steps-post' if held else 'default'
            values = plan.control(name) if name in plan.control_names else plan.state(name)
            axis.plot(plan.times, values, color=colours[vehicle], drawstyle=style)
        _draw_limits(axis, *bounds.get(name, ()))
        _label(axis, name, first.units.get(name, ''))
    _, last = np.split(axes, [len(names)])
    for axis, (name, unit) in zip(last, kept.items(), strict=True):
        for vehicle, found in margins.items():
            for margin in (m for m in found if m.name == name):
                axis.plot(margin.times, margin.values, color=colours[vehicle])
        _draw_limits(axis, 0.0)
        _label(axis, f'margin of\n{name}', unit)
    for axis in axes:
        for instant in switches:
            axis.axvline(instant, color=SWITCH, lw=0.7, ls=':')
    handles = {} if len(plans) == 1 else {n: Line2D([], [], color=c) for n, c in colours.items()}
    handles['limits'] = Line2D([], [], color=LIMIT, lw=1, ls='--')
    if len(switches):
        handles['switching points'] = Line2D([], [], color=SWITCH, lw=0.7, ls=':')
    legend_above(axes[0], handles)
    axes[-1].set_xlabel(TIME_LABEL)


def _draw_limits(axis: Axes, *levels: float) -> None:
    for level in levels:
        axis.axhline(level, color=LIMIT, lw=1, ls='--')


def _label(axis: Axes, name: str, unit: str) -> None:
    axis.set_ylabel(f'{name} [{unit}]' if unit else name)
    axis.grid(alpha=0.25)


def legend_above(axis: Axes, handles: Mapping[str, Artist], columns: int = 6) -> None:
    """Put a legend above a panel."""
    axis.legend(
        list(handles.values()),
        list(handles),
        loc='lower right',
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        fontsize='small',
        frameon=False,
    )


def _drawn(view: PlantView, plan: Trajectory, times: Array) -> Sequence[Shape]:
    """Return the shapes of a plant at instants of its plan; controls act during the motion."""
    states, controls = plan.sample(times)
    return view.shapes(states, controls * (times <= plan.duration)[:, None])


def _picture(part: SubFigure, view: PlantView, plans: Plans) -> None:
    """Draw the plants' ways in the plane, with bodies now and then, and their distances."""
    apart = bool(view.place) and len(plans) > 1
    axes = part.subplots(1 + apart, 1, height_ratios=[2.6, 1][: 1 + apart], squeeze=False)[:, 0]
    ground, colours = axes[0], _coloured(plans)
    end = max(plan.duration for plan in plans.values())
    for shape in view.surroundings():
        _draw_shape(ground, shape, 1, '0.3', faint=False)
    for name, plan in plans.items():
        for shape in _drawn(view, plan, np.linspace(0.0, end, _INSTANTS)):
            if shape.trail:
                ground.plot(*way_of(shape, _INSTANTS).T, color=colours[name])
        for shape in _drawn(view, plan, np.linspace(0.0, end, _BODIES)):
            _draw_shape(ground, shape, _BODIES, colours[name])
    ground.set_aspect('equal')
    ground.autoscale_view()
    ground.set_xlabel('x [m]')
    ground.set_ylabel('y [m]')
    legend_above(ground, {name: Line2D([], [], color=colour) for name, colour in colours.items()})
    if apart:
        _distances(axes[1], view, plans)


def _draw_shape(axis: Axes, shape: Shape, count: int, colour: str, faint: bool = True) -> None:
    points, colour = points_of(shape, count), _COLOURS.get(shape.style, colour)
    ls = '--' if shape.style in ('limit', 'reach') else '-'
    for k, at in enumerate(points):
        alpha = 0.2 + 0.6 * k / count if faint else 1.0
        if isinstance(shape, Disc):
            circle = Circle(tuple(at[0]), shape.radius, fc='none', ec=colour, ls=ls, alpha=alpha)
            axis.add_patch(circle)
        else:
            axis.plot(*at.T, color=colour, ls=ls, alpha=alpha, lw=1.2)


def _distances(axis: Axes, view: PlantView, plans: Plans) -> None:
    times = np.linspace(0.0, max(plan.duration for plan in plans.values()), 600)
    places = {}
    for name, plan in plans.items():
        at = plan.sample(times).state
        places[name] = at[:, [plan.state_names.index(state) for state in view.place]]
    for k, (one, other) in enumerate(itertools.combinations(plans, 2)):
        distance = np.linalg.norm(places[one] - places[other], axis=1)
        colour = COLOURS[k % len(COLOURS)]
        axis.plot(times, distance, color=colour, label=f'{one} - {other}')
    if view.separation is not None:
        _draw_limits(axis, view.separation)
    axis.set_ylim(bottom=0.0)
    _label(axis, 'distance', 'm')
    axis.set_xlabel(TIME_LABEL)
    if len(plans) <= _FEW:
        axis.legend(fontsize='x-small', loc='upper right')

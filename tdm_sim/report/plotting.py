# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A plan as a picture: the plants' way, and the charts of its report; PNG, PDF or SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import io
from pathlib import Path
import textwrap

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
from tdm_planner.plan_files import write_file
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_sim.report.animation import planned_frames
from tdm_sim.report.charts import mission_charts, Panel
from tdm_sim.report.mission import Mission, RecordedVehicle
from tdm_sim.report.recorded_vehicles import planned_vehicles

_ROW, _LETTERS = 1.6, 17  # height of a panel [inches], and how much of a label stands along it
_INSTANTS = 1000  # of ways
_BODIES = 9  # instants at which the plants are drawn
_COLOURS = {'limit': LIMIT, 'reach': SWITCH, 'force': STYLE_COLOURS['force']}


def plot_solution(problem: Problem, solution: Solution, path: Path) -> None:
    """
    Write the picture of a solution, with the problem's limits, to `path`.

    Raise UnusableFile if it cannot be written.
    """
    vehicles, picture = planned_vehicles(problem, solution.trajectories), io.BytesIO()
    figure = plot_plan(Mission(solution.summary, vehicles))
    figure.savefig(picture, format=path.suffix[1:].lower(), dpi=110)
    write_file(path, picture.getvalue())


def plot_plan(mission: Mission) -> Figure:
    """Draw states, controls, margins and, of plants in the plane, their ways and distances."""
    charts = {c.key: c.panels for c in mission_charts(mission)}
    states, controls, apart = (charts.get(k, ()) for k in ('states', 'controls', 'distances'))
    margins = [p._replace(title=f'margin of\n{p.title}') for p in charts.get('margins', ())]
    shapes = _drawn(mission.vehicles[0], np.zeros(1))
    if not shapes or points_of(shapes[0], 1).shape[-1] > 2:
        panels = [*states, *controls, *margins]
        figure = Figure(figsize=(9, _ROW * len(panels) + 1.0), layout='constrained')
        _histories(figure, mission, panels)
    else:
        rows = max(len(states), len(controls) + len(margins))
        figure = Figure(figsize=(18, max(11.5, _ROW * rows + 1.0)), layout='constrained')
        thirds = figure.subfigures(1, 3, width_ratios=[1.3, 1, 1])
        assert isinstance(thirds, np.ndarray)
        _picture(thirds[0], mission, apart)
        _histories(thirds[1], mission, states)
        _histories(thirds[2], mission, [*controls, *margins])
    figure.suptitle(mission.title, fontsize='medium', wrap=True)
    return figure


def _coloured(mission: Mission) -> dict[str, str]:
    return {v.name: COLOURS[k % len(COLOURS)] for k, v in enumerate(mission.vehicles)}


def _histories(part: Figure | SubFigure, mission: Mission, panels: Sequence[Panel]) -> None:
    axes = part.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, panel in zip(axes, panels, strict=True):
        _draw_panel(axis, panel)
        for instant in panel.switches:
            axis.axvline(instant, color=SWITCH, lw=0.7, ls=':')
    colours = _coloured(mission) if len(mission.vehicles) > 1 else {}
    handles = {name: Line2D([], [], color=colour) for name, colour in colours.items()}
    if any(panel.limits for panel in panels):
        handles['limits'] = Line2D([], [], color=LIMIT, lw=1, ls='--')
    if any(panel.switches for panel in panels):
        handles['switching points'] = Line2D([], [], color=SWITCH, lw=0.7, ls=':')
    legend_above(axes[0], handles)
    _label_time(axes[-1])


def _draw_panel(axis: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        (line,) = axis.plot(curve.times, curve.values, label=curve.series)
        line.set_color(COLOURS[curve.colour % len(COLOURS)])
        line.set_drawstyle('steps-post' if curve.held else 'default')
    for level in panel.limits:
        axis.axhline(level, color=LIMIT, lw=1, ls='--')
    unit = f' [{panel.unit}]' if panel.unit else ''
    lines = [part for line in panel.title.split('\n') for part in textwrap.wrap(line, _LETTERS)]
    fits = len(lines[-1] + unit) <= _LETTERS
    axis.set_ylabel('\n'.join(lines) + (unit if fits else f'\n{unit.strip()}'))
    axis.grid(alpha=0.25)


def _label_time(axis: Axes) -> None:
    axis.set_xlabel('time from the start of the motion [s]')


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


def _drawn(vehicle: RecordedVehicle, times: Array) -> Sequence[Shape]:
    """Return the shapes of a plant at instants (n,) of its plan."""
    frames = planned_frames(vehicle, times)
    return vehicle.view.drawing(*frames) if frames else ()


def _picture(part: SubFigure, mission: Mission, apart: Sequence[Panel]) -> None:
    """Draw the plants' ways in the plane, with bodies now and then, and their distances."""
    rows = 1 + len(apart)
    axes = part.subplots(rows, 1, height_ratios=[2.6, 1][:rows], squeeze=False)[:, 0]
    ground, colours = axes[0], _coloured(mission)
    for shape in mission.vehicles[0].view.surroundings:
        _draw_shape(ground, shape, 1, '0.3', faint=False)
    for vehicle in mission.vehicles:
        colour = colours[vehicle.name]
        for shape in _drawn(vehicle, np.linspace(*mission.span, _INSTANTS)):
            if shape.trail:
                ground.plot(*way_of(shape, _INSTANTS).T, color=colour)
        for shape in _drawn(vehicle, np.linspace(*mission.span, _BODIES)):
            _draw_shape(ground, shape, _BODIES, colour)
    ground.set_aspect('equal')
    ground.autoscale_view()
    ground.set_xlabel('x [m]')
    ground.set_ylabel('y [m]')
    legend_above(ground, {name: Line2D([], [], color=colour) for name, colour in colours.items()})
    for axis, panel in zip(axes[1:], apart, strict=True):
        _draw_panel(axis, panel)
        axis.set_ylim(bottom=0.0)
        if any(curve.series for curve in panel.curves):
            axis.legend(fontsize='x-small', loc='upper right')
        _label_time(axis)


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

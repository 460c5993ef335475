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

"""A formation plan as a picture: the arena from above, controls and distances over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import itertools

from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
import numpy as np
from numpy.typing import NDArray
from tdm_planner.measured_robot import MeasuredRobot, pair_distance
from tdm_planner.palette import COLOURS, LIMIT
from tdm_planner.plan_margins import PlanMargin
from tdm_planner.plotting import draw_limits, draw_planned, label_quantity, TIME_LABEL
from tdm_planner.problems.base import Problem
from tdm_planner.problems.robot_formation import RobotFormation
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_BODIES = 9  # instants at which the bodies are drawn


@dataclass(frozen=True, eq=False)
class FormationView:
    """What of the problem is drawn: arena, keep-out zones (k, 3), separation, limits by name."""

    length: float
    width: float
    separation: float
    obstacles: Array
    limits: Mapping[str, float]

    def bounds(self, name: str) -> tuple[float, ...]:
        """Return the limits of a state or control, if it has any."""
        if name in ('x', 'y'):
            side = self.length if name == 'x' else self.width
            return self.separation / 2, side - self.separation / 2
        if name not in self.limits:
            return ()
        return (0.0 if name == 'thrust' else -self.limits[name]), self.limits[name]

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
    margins: Mapping[str, Sequence[PlanMargin]] | None = None,
) -> Figure:
    """Draw arena, distances, and every state, control and margin; planned and measured."""
    measured, margins = measured or {}, margins or {}
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(plans)}
    figure = Figure(figsize=(18, 11.5), layout='constrained')
    thirds = figure.subfigures(1, 3, width_ratios=[1.3, 1, 1])
    assert isinstance(thirds, np.ndarray)
    arena, distances = thirds[0].subplots(2, 1, height_ratios=[2.6, 1])
    _draw_arena(arena, view)
    end = max(plan.duration for plan in plans.values())
    for name, plan in plans.items():
        _draw_robot(arena, view, plan, colours[name], np.linspace(0.0, end, _BODIES))
        if name in measured:
            columns = measured[name].columns
            arena.plot(columns['x'], columns['y'], color=colours[name], lw=4, alpha=0.4)
    _explain(arena, colours, bool(measured))
    _draw_distances(distances, view, plans, measured)
    distances.set_xlabel(TIME_LABEL)
    histories = _Histories(view, plans, measured, colours)
    plan = next(iter(plans.values()))
    histories.draw(thirds[1], plan.state_names, {})
    histories.draw(thirds[2], plan.control_names, margins)
    if title:
        figure.suptitle(title)
    return figure


@dataclass(frozen=True, eq=False)
class _Histories:
    """Quantities of all robots over time, one panel each."""

    view: FormationView
    plans: Mapping[str, Trajectory]
    measured: Mapping[str, MeasuredRobot]
    colours: Mapping[str, str]

    def draw(
        self, part: SubFigure, names: Sequence[str], margins: Mapping[str, Sequence[PlanMargin]]
    ) -> None:
        """Draw panels of states or controls, then of margins."""
        kept = {m.name: m.unit for found in margins.values() for m in found}
        axes = part.subplots(len(names) + len(kept), 1, sharex=True, squeeze=False)[:, 0]
        for axis, name in zip(axes, names, strict=False):
            self._draw_quantity(axis, name)
        first = len(names)
        for axis, (name, unit) in zip(axes[first:], kept.items(), strict=True):
            for robot, found in margins.items():
                for margin in found:
                    if margin.name == name:
                        axis.plot(margin.times, margin.values, color=self.colours[robot])
            draw_limits(axis, 0.0)
            label_quantity(axis, f'margin of\n{name}', unit)
        axes[-1].set_xlabel(TIME_LABEL)

    def _draw_quantity(self, axis: Axes, name: str) -> None:
        unit = ''
        for robot, plan in self.plans.items():
            seen = self.measured.get(robot)
            if seen is not None and name in seen.columns:
                axis.plot(
                    seen.times, seen.columns[name], color=self.colours[robot], lw=3, alpha=0.4
                )
            draw_planned(axis, plan, name, self.colours[robot])
            unit = unit or plan.units.get(name, '')
        draw_limits(axis, *self.view.bounds(name))
        label_quantity(axis, name, unit)


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
    axis: Axes, view: FormationView, plan: Trajectory, colour: str, instants: Array
) -> None:
    """Path, bodies with heading at the instants, and arrows where there is thrust."""
    axis.plot(plan.state('x'), plan.state('y'), color=colour)
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


def _explain(axis: Axes, colours: Mapping[str, str], measured: bool) -> None:
    """Put a legend above the arena: whose colour, and what is planned, measured, a limit."""
    handles = [Line2D([], [], color=colour, label=name) for name, colour in colours.items()]
    handles.append(Line2D([], [], color='0.3', label='planned'))
    if measured:
        handles.append(Line2D([], [], color='0.3', lw=3, alpha=0.4, label='measured'))
    handles.append(Line2D([], [], color=LIMIT, lw=1, ls='--', label='limits'))
    axis.legend(
        handles=handles,
        loc='lower left',
        bbox_to_anchor=(0.0, 1.0),
        ncols=6,
        fontsize='small',
        frameon=False,
    )


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
        colour = COLOURS[k % len(COLOURS)]
        distance = np.linalg.norm(paths[one] - paths[other], axis=1)
        axis.plot(times, distance, color=colour, label=f'{one} - {other}')
        if one in measured and other in measured:
            at, seen = pair_distance(measured[one], measured[other])
            axis.plot(at, seen, color=colour, lw=3, alpha=0.4)
    draw_limits(axis, view.separation)
    axis.set_ylim(bottom=0.0)
    label_quantity(axis, 'distance', 'm')
    if len(plans) <= 4:
        axis.legend(fontsize='x-small', loc='upper right')

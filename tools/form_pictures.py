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

"""
Draw both forms of the robots' motions on one crossing, with their costs.

    python -m tools.form_pictures [docs/images]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from benchmark.scenarios import crossing
from matplotlib.figure import Figure
from matplotlib.patches import Circle
import numpy as np
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.base import Solution

SEED = 4
COLOURS = ('#0072b2', '#d55e00', '#009e73')
TITLES = {'polynomials': 'Polynomials', 'thrust_arcs': 'Thrust arcs'}


def planned(method: str) -> Solution:
    """Plan the crossing with no thrust in reserve."""
    values = crossing(SEED).parameters(method=method, thrust_reserve=0.0)
    return RobotFormation.from_parameters(values).solve(deadline=20.0)


def draw_ways(axes: Any, solution: Solution) -> None:
    """Draw the ways, thick where thrust is on, starts as rings and goals as discs."""
    for colour, plan in zip(COLOURS, solution.trajectories.values(), strict=True):
        times = np.linspace(0.0, plan.duration, 1500)
        sample = plan.sample(times)
        x, y = sample.state[:, 0], sample.state[:, 1]
        share = sample.control[:, 0] / plan.control('thrust').max()
        axes.plot(x, y, color=colour, linewidth=1.0)
        axes.scatter(x, y, s=24.0 * share, color=colour, linewidths=0)
        axes.add_patch(Circle((x[0], y[0]), 0.1, fill=False, edgecolor=colour))
        axes.add_patch(Circle((x[-1], y[-1]), 0.1, color=colour, alpha=0.3))
    axes.set_xlabel('x [m]')
    axes.set_ylabel('y [m]')
    axes.set_aspect('equal', adjustable='datalim')


def draw_thrust(axes: Any, solution: Solution) -> None:
    """Draw the thrust of every robot over time."""
    for colour, (name, plan) in zip(COLOURS, solution.trajectories.items(), strict=True):
        held = plan.interpolation == 'zero_order_hold'
        style = 'steps-post' if held else 'default'
        axes.plot(
            plan.times,
            plan.control('thrust'),
            color=colour,
            linewidth=1.2,
            drawstyle=style,
            label=name,
        )
    axes.set_xlabel('time [s]')
    axes.set_ylabel('thrust [N]')
    axes.set_xlim(0.0, 45.0)
    axes.set_ylim(-0.01, 0.4)


def picture() -> Figure:
    """Return both forms side by side."""
    figure = Figure(figsize=(9.0, 6.6), layout='constrained')
    axes = figure.subplots(2, 2, height_ratios=[1.6, 1.0])
    for column, (method, title) in enumerate(TITLES.items()):
        solution = planned(method)
        axes[0, column].set_title(f'{title}: J = {solution.cost:.3f}')
        draw_ways(axes[0, column], solution)
        draw_thrust(axes[1, column], solution)
    axes[1, 0].legend(loc='upper center', ncols=3, frameon=False)
    return figure


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description='draw both forms')
    parser.add_argument('folder', type=Path, nargs='?', default=Path('docs/images'))
    file = parser.parse_args().folder / 'thrust_arcs.png'
    picture().savefig(file, dpi=110)
    print(f'written: {file}')


if __name__ == '__main__':
    main()

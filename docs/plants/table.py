# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What every page of the gallery prints and draws: its plans beside the best known optima."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from tdm_planner.problems import DirectProblem, Solution

HERE = Path(__file__).resolve().parent
GALLERY = {  # module: class
    'acrobot': 'Acrobot',
    'auv': 'Auv',
    'ball_and_beam': 'BallAndBeam',
    'bryson_denham': 'BrysonDenham',
    'crane': 'Crane',
    'goddard_rocket': 'GoddardRocket',
    'moon_lander': 'MoonLander',
    'overtaking': 'Overtaking',
    'quadrotor': 'Quadrotor',
    'satellite': 'Satellite',
}


def cases(variations: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Return the parameters of all cases by the names that best_known.json has for them."""
    return {'default': {}, **{str(i): given for i, given in enumerate(variations)}}


def best_known() -> Any:
    """Return the best known optima: class, case, figures (collocated.py)."""
    return json.loads((HERE / 'best_known.json').read_text())


def show(
    cls: type[DirectProblem],
    variations: Sequence[Mapping[str, Any]],
    published: Mapping[str, tuple[float, str]],
    plane: tuple[str, str] | None = None,
) -> None:
    """Plan for every case, print what comes of it, and draw the first."""
    print('case       J            best known   over     time [s]   published')
    for case, given in cases(variations).items():
        plan = cls.from_parameters(given).solve()
        best = best_known()[cls.__name__][case]['cost']
        over = 100.0 * (plan.cost - best) / abs(best)
        known = f'{published[case][0]:.5g}' if case in published else ''
        print(
            f'{case:9s}  {plan.cost:<11.6g}  {best:<11.6g}  {over:5.2f} %  {plan.solve_time:8.3f}'
            f'   {known:9s}  {dict(given) or ""}'
        )
        if case == 'default':
            draw(plan, HERE.parent / 'images' / 'plants' / f'{cls.name}.png', plane)
    for case, (value, source) in published.items():
        print(f'published, {case}: {value:.6g} ({source})')


def draw(plan: Solution, path: Path, plane: tuple[str, str] | None = None) -> None:
    """Draw states and controls over time, by their units, and the way in a plane of two states."""
    way = plan.trajectory
    charts: dict[tuple[str, str], list[tuple[str, Any]]] = {}
    for what, names, units, rows in (
        ('state', way.state_names, way.state_units, way.states),
        ('control', way.control_names, way.control_units, way.controls),
    ):
        for name, unit, row in zip(names, units, rows.T, strict=True):
            charts.setdefault((what, unit), []).append((name, row))
    count = len(charts) + (plane is not None)
    down = -(-count // 3)
    across = -(-count // down)
    figure, axes = plt.subplots(down, across, figsize=(4 * across, 3 * down), squeeze=False)
    for axis, ((what, unit), curves) in zip(axes.flat, charts.items(), strict=False):
        for name, row in curves:
            axis.plot(way.times, row, '-' if what == 'state' else '--', label=name)
        axis.set(xlabel='time [s]', ylabel=f'[{unit}]' if unit else '')
        axis.legend(fontsize='small')
    for axis in axes.flat[count:]:
        axis.remove()
    if plane:
        x, y = (way.states[:, way.state_names.index(name)] for name in plane)
        axis = axes.flat[count - 1]
        axis.plot(x, y, 'k-')
        axis.plot(x[[0, -1]], y[[0, -1]], 'ko')
        axis.set(xlabel=f'{plane[0]} [m]', ylabel=f'{plane[1]} [m]')
        if max(np.ptp(x), np.ptp(y)) < 5.0 * min(np.ptp(x), np.ptp(y)):
            axis.set_aspect('equal', 'datalim')
    for axis in axes.flat[:count]:
        axis.grid(alpha=0.3)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)

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

"""What every page of the gallery prints and draws: its plans beside the best known optima."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
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
    """Return the best known optima: class, case, figures (tools/collocate_plants.py)."""
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
    """Draw states and controls over time, and the way in the plane of two states."""
    trajectory = plan.trajectory
    figure, axes = plt.subplots(1, 3 if plane else 2, figsize=(12 if plane else 9, 3.4))
    for axis, rows, names, units in (
        (axes[0], trajectory.states, trajectory.state_names, trajectory.state_units),
        (axes[1], trajectory.controls, trajectory.control_names, trajectory.control_units),
    ):
        for row, name, unit in zip(rows.T, names, units, strict=True):
            axis.plot(trajectory.times, row, label=f'{name} [{unit}]' if unit else name)
        axis.set_xlabel('time [s]')
        axis.legend(fontsize='small')
    if plane:
        across, up = (trajectory.states[:, trajectory.state_names.index(n)] for n in plane)
        axes[2].plot(across, up)
        axes[2].plot(across[[0, -1]], up[[0, -1]], 'o')
        axes[2].set(xlabel=f'{plane[0]} [m]', ylabel=f'{plane[1]} [m]', aspect='equal')
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)

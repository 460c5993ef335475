# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Animated pictures of the demos, in real time, from their recordings: demo_*.gif beside this file.

tdm demo pendulum; tdm demo robots
python docs/images/demos.py pendulum/bag robots/bag
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import sys
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
import numpy as np
from PIL import Image
from tdm_planner.drawing import COLOURS, Disc, LIMIT, Line, points_of, Shape
from tdm_sim.report.animation import measured_frames, planned_frames
from tdm_sim.report.mission import Mission
from tdm_sim.report.reader import read_mission

Update = Callable[[int], Any]  # shows the instant of that number

BEFORE, AFTER = 0.5, 2.0  # s shown before the motion starts and after it ends
INTERVAL, LAST = 60, 1500  # ms that a frame and the last one stay
FINE = 6  # instants of the curves a frame
PANELS = {'pendulum': ('theta', 'torque'), 'robots': ('x', 'y', 'thrust')}
LOOKS = {'limit': (LIMIT, '--'), 'reach': ('0.6', ':'), 'force': ('#e08a00', '-')}


def animate(mission: Mission, name: str) -> list[Image.Image]:
    """Return the frames: the plants in motion, beside them what was planned and measured."""
    end = max(plan.end for vehicle in mission.vehicles for plan in vehicle.plans)
    times = np.arange(-BEFORE, end + AFTER, INTERVAL / 1e3 / FINE)
    figure = Figure(figsize=(8.0, 3.8), layout='constrained')
    canvas: Any = FigureCanvasAgg(figure)
    parts: Any = figure.subfigures(1, 2, width_ratios=[1.1, 1])
    scene = parts[0].add_subplot(projection='3d' if name == 'pendulum' else None)
    axes = parts[1].subplots(len(PANELS[name]), 1, sharex=True)
    axes[-1].set_xlabel('time [s]  (thin: planned, bold: measured)')
    updates = [_shown(scene, shape, 1, '0.4') for shape in mission.vehicles[0].view.surroundings]
    for vehicle, colour in zip(mission.vehicles, COLOURS, strict=False):
        planned, measured = planned_frames(vehicle, times), measured_frames(vehicle, times)
        if planned is None or measured is None:
            raise SystemExit(f'{mission.source} has no plan, or no motion, of {vehicle.name}')
        updates += _moving(scene, vehicle.view, planned, measured, colour)
        for axis, signal in zip(axes, PANELS[name], strict=True):
            axis.plot(times, (planned[0] | planned[1])[signal], color=colour, lw=0.8, alpha=0.6)
            (line,) = axis.plot([], [], color=colour, lw=1.8)
            curve = np.stack([times, (measured[0] | measured[1])[signal]], axis=1)
            updates.append(_growing(line, curve))
            axis.set_ylabel(f'{signal} [{vehicle.view.kind.units[signal]}]')
            axis.grid(alpha=0.25)
    scene.set_axis_off()
    if name == 'pendulum':
        sides = scene.get_xlim(), scene.get_ylim(), scene.get_zlim()
        scene.set_box_aspect(np.ptp(sides, axis=1), zoom=1.5)
    else:
        scene.set_aspect('equal')
    frames = []
    for k in range(0, times.size, FINE):
        for update in updates:
            update(k)
        scene.set_title(f'{times[k]:.1f} s', fontsize='medium')
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    palette = frames[len(frames) // 2].quantize(64, Image.Quantize.MAXCOVERAGE)
    return [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]


def _moving(scene: Any, view: Any, planned: Any, measured: Any, colour: str) -> Iterator[Update]:
    """Draw the planned path of a vehicle; yield what moves: its shapes and their trails."""
    count = next(iter(measured[0].values())).size
    for shape in view.drawing(*planned):
        if shape.trail:
            scene.plot(*points_of(shape, count)[:, -1].T, color=colour, lw=0.8, alpha=0.6)
    for shape in view.drawing(*measured):
        yield _shown(scene, shape, count, colour)
        if shape.trail:
            path = points_of(shape, count)[:, -1]
            (line,) = scene.plot(*path[:1].T, color=colour, lw=1.8)
            yield _growing(line, path)


def _shown(scene: Any, shape: Shape, count: int, colour: str) -> Update:
    points, (colour, ls) = points_of(shape, count), LOOKS.get(shape.style, (colour, '-'))
    if isinstance(shape, Disc):
        circle = scene.add_patch(Circle((0, 0), shape.radius, fc='none', ec=colour, ls=ls, lw=1.5))
        return lambda k: circle.set_center(points[k % count, 0])
    body = isinstance(shape, Line) and shape.style == 'body' and count > 1
    (line,) = scene.plot(*points[0].T, color=colour, ls=ls, lw=4.0 if body else 1.5)
    return lambda k: _put(line, points[k % count])


def _growing(line: Any, path: Any) -> Update:
    return lambda k: _put(line, path[: k + 1])


def _put(line: Any, points: Any) -> None:
    """Move a line to `points` (k, 2 or 3)."""
    (line.set_data if points.shape[1] == 2 else line.set_data_3d)(*points.T)


def main() -> None:
    """Write the picture of every recording that is named."""
    for bag in sys.argv[1:]:
        mission = read_mission(Path(bag))
        name = 'robots' if len(mission.vehicles) > 1 else 'pendulum'
        frames = animate(mission, name)
        path = Path(__file__).with_name(f'demo_{name}.gif')
        durations = [INTERVAL] * (len(frames) - 1) + [LAST]
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0)
        print(f'{path}: {len(frames)} frames, {path.stat().st_size / 1e3:.0f} kB')


if __name__ == '__main__':
    main()

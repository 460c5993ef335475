# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The data of the page's animation: the shapes of every vehicle on common frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.drawing import COLOURS, Disc, points_of, Shape
from tdm_sim.report.charts import packed
from tdm_sim.report.mission import Mission, RecordedVehicle

Frames = Mapping[str, Array]  # states or controls by name, (n,)

RATE = 60.0  # frames per second of the motion; the page reads between frames
FEWEST_FRAMES, MOST_FRAMES = 200, 1200
MOST_POSES = 6000  # frames of all vehicles together


def scene(mission: Mission) -> dict[str, Any] | None:
    """Return the animation's data as JSON holds it; None if no vehicle has a picture."""
    times = frame_times(mission)
    vehicles = [
        _vehicle(vehicle, times, k % len(COLOURS)) for k, vehicle in enumerate(mission.vehicles)
    ]
    drawn = [part for v in vehicles for part in (v['planned'], v['measured']) if part]
    if not drawn:
        return None
    view = mission.vehicles[0].view
    return {
        'times': packed(times),
        'space': drawn[0][0]['size'] > 2,
        'ground': _shapes(view.surroundings, 1),
        'vehicles': vehicles,
    }


def frame_times(mission: Mission) -> Array:
    """Return the instants of the frames: evenly spread, and where plans start and end."""
    start, end = mission.span
    count = math.ceil((end - start) * RATE) + 1
    most = min(MOST_FRAMES, MOST_POSES // max(len(mission.vehicles), 1))
    even = np.linspace(start, end, max(min(count, most), FEWEST_FRAMES))
    return np.union1d(even, [at for plan in mission.plans for at in (plan.start, plan.end)])


def _vehicle(vehicle: RecordedVehicle, times: Array, colour: int) -> dict[str, Any]:
    view = vehicle.view
    found: dict[str, Any] = {'name': vehicle.name, 'colour': colour}
    for kind, frames in (
        ('planned', planned_frames(vehicle, times)),
        ('measured', measured_frames(vehicle, times)),
    ):
        found[kind] = _shapes(view.drawing(*frames), times.size) if frames else []
    if vehicle.plan is not None:
        last = vehicle.plan.trajectory
        ends = dict(zip(last.state_names, last.states[-1:].T, strict=True))
        found['goal'] = _shapes([s for s in view.drawing(ends, {}) if s.style == 'body'], 1)
    return found


def _shapes(shapes: Sequence[Shape], count: int) -> list[dict[str, Any]]:
    """Return shapes as the page reads them: points (count, k, size) in a row."""
    return [
        {
            'kind': type(shape).__name__.lower(),
            'style': shape.style,
            'trail': shape.trail,
            'radius': shape.radius if isinstance(shape, Disc) else 0.0,
            'corners': points.shape[1],
            'size': points.shape[2],
            'points': packed(points.ravel()),
        }
        for shape in shapes
        for points in [points_of(shape, count)]
    ]


def planned_frames(vehicle: RecordedVehicle, times: Array) -> tuple[Frames, Frames] | None:
    """Return planned states, and controls while they act, at `times`; None if there is no plan."""
    if not vehicle.plans:
        return None
    states, controls = vehicle.planned(times)
    moving = np.zeros(times.size, dtype=bool)
    for plan in vehicle.plans:
        moving |= (times >= plan.start) & (times <= plan.followed_until)
    acting = {name: moving * column for name, column in controls.columns.items()}
    return states.columns, acting


def measured_frames(vehicle: RecordedVehicle, times: Array) -> tuple[Frames, Frames] | None:
    """Return measured states and controls at `times`, NaN where nothing was; None if no states."""
    if not vehicle.states or vehicle.plan is None:
        return None
    motion = vehicle.plan.trajectory
    states, controls = vehicle.states.at(times), (vehicle.controls or vehicle.states).at(times)
    return (
        states.select(motion.state_names).columns,
        controls.select(motion.control_names).columns,
    )

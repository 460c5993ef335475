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

"""What the page's animation draws: the motion of every vehicle on common frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.palette import COLOURS
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.report.embedding import packed
from tdm_sim.report.mission import Mission, Signals, Vehicle

Array = NDArray[np.float64]
Frames = dict[str, Array]  # by name, (n,)

# Frames per second of the motion; the page reads between frames.
FRAME_RATES = {'pendulum': 100.0, 'robot': 25.0}
FEWEST_FRAMES, MOST_FRAMES = 200, 1500
MOST_POSES = 6000  # frames of all vehicles together

_PENDULUM = ('theta', 'psi', 'torque')
_ROBOT = ('x', 'y', 'yaw', 'alpha', 'thrust')
_ANGLES = ('yaw', 'alpha')
_LONGEST_GAP, _GAP_RATIO = 0.25, 5.0  # s; of the time between samples


def scene(mission: Mission) -> dict[str, Any] | None:
    """Return the animation's data as JSON holds it; None if the vehicles are of no known kind."""
    kinds = {vehicle.plant for vehicle in mission.vehicles}
    if kinds == {'pendulum'}:
        return _pendulum_scene(mission)
    if kinds == {'robot'}:
        return _arena_scene(mission)
    return None


def frame_times(mission: Mission, rate: float) -> Array:
    """Return the instants of the frames: evenly spread, and where plans start and end."""
    start, end = mission.span
    count = math.ceil((end - start) * rate) + 1
    most = min(MOST_FRAMES, MOST_POSES // len(mission.vehicles))
    even = np.linspace(start, end, max(min(count, most), FEWEST_FRAMES))
    plans = [plan for vehicle in mission.vehicles for plan in vehicle.plans]
    return np.union1d(even, [at for plan in plans for at in (plan.start, plan.end)])


def planned_frames(vehicle: Vehicle, times: Array, names: Sequence[str]) -> Frames | None:
    """
    Return planned states and controls at `times`, of the plan in force then; None if no plan.

    Before the first motion its start is shown, after a motion its end; controls act during it.
    """
    if not vehicle.plans:
        return None
    frames = {name: np.full(times.size, np.nan) for name in names}
    for index, plan in enumerate(vehicle.plans):
        inside = times >= (plan.start if index else -math.inf)
        at = times[inside]
        moving = (at >= plan.start) & (at <= plan.end)
        trajectory = plan.trajectory
        columns = dict(zip(trajectory.state_names, plan.states(at).T, strict=True))
        controls = moving[:, None] * plan.controls(at)
        columns |= dict(zip(trajectory.control_names, controls.T, strict=True))
        for name in names:
            if name in columns:
                frames[name][inside] = columns[name]
    return frames


def measured_frames(vehicle: Vehicle, times: Array, names: Sequence[str]) -> Frames | None:
    """Return measured states and controls at `times`, NaN where nothing was; None if no states."""
    if vehicle.states is None:
        return None
    return {name: _read(name, times, vehicle.states, vehicle.controls) for name in names}


def _read(name: str, times: Array, *sources: Signals | None) -> Array:
    for signals in sources:
        if signals is not None and name in signals:
            return _between(times, signals.times, signals.column(name), name in _ANGLES)
    return np.full(times.size, np.nan)


def _between(times: Array, instants: Array, values: Array, angle: bool) -> Array:
    """Read a history at `times`, NaN outside and in the midst of gaps."""
    known = np.isfinite(values)
    instants, values = instants[known], values[known]
    if instants.size < 2:
        return np.full(times.size, np.nan)
    found = np.interp(times, instants, np.unwrap(values) if angle else values)
    gap = max(_LONGEST_GAP, _GAP_RATIO * float(np.median(np.diff(instants))))
    after = np.clip(np.searchsorted(instants, times), 1, instants.size - 1)
    outside = (times < instants[0]) | (times > instants[-1])
    return np.where(outside | (np.diff(instants)[after - 1] > gap), np.nan, found)


def _columns(frames: Mapping[str, Array] | None) -> dict[str, Any] | None:
    return None if frames is None else {name: packed(v) for name, v in frames.items()}


def _pendulum_scene(mission: Mission) -> dict[str, Any]:
    (vehicle, *_) = mission.vehicles
    plant = RotaryPendulum()
    times = frame_times(mission, FRAME_RATES['pendulum'])
    return {
        'kind': 'pendulum',
        'times': packed(times),
        'arm': mission.number('plant.arm_length') or plant.arm_length,
        # the rod is drawn as uniform: twice as long as its centre of mass is far
        'rod': 2.0 * (mission.number('plant.com_distance') or plant.com_distance),
        'diskLimit': mission.number('limits.disk_angle'),
        'torqueLimit': mission.number('limits.torque'),
        'planned': _columns(planned_frames(vehicle, times, _PENDULUM)),
        'measured': _columns(measured_frames(vehicle, times, _PENDULUM)),
    }


def _arena_scene(mission: Mission) -> dict[str, Any]:
    times = frame_times(mission, FRAME_RATES['robot'])
    obstacles = mission.numbers('arena.obstacles')
    circles = np.zeros(0) if obstacles is None else obstacles[: obstacles.size // 3 * 3]
    return {
        'kind': 'arena',
        'times': packed(times),
        'length': mission.number('arena.length'),
        'width': mission.number('arena.width'),
        'separation': mission.number('arena.minimum_separation'),
        'thrustLimit': mission.number('limits.thrust'),
        'obstacles': circles.reshape(-1, 3).tolist(),
        'robots': [
            _robot(vehicle, times, k % len(COLOURS)) for k, vehicle in enumerate(mission.vehicles)
        ],
    }


def _robot(vehicle: Vehicle, times: Array, colour: int) -> dict[str, Any]:
    plan = vehicle.plan
    goal = None
    if plan is not None:
        end = plan.trajectory
        goal = [float(end.state(name)[-1]) for name in ('x', 'y', 'yaw')]
    return {
        'name': vehicle.name,
        'colour': colour,
        'goal': goal,
        'planned': _columns(planned_frames(vehicle, times, _ROBOT)),
        'measured': _columns(measured_frames(vehicle, times, _ROBOT)),
    }

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

"""Was the goal reached and held? Judged on the measured states alone."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

HOLD_TIME = 5.0
UPRIGHT_TOLERANCE = 0.05
LONGEST_CATCH = 3.0

_STEP, _MOST_STEPS = 0.001, 50_000


@dataclass(frozen=True)
class MeasuredPendulum:
    """What the plant published: times (n,) s from the start of the motion, states, torque."""

    times: Array
    theta: Array
    psi: Array
    theta_dot: Array
    psi_dot: Array
    torque: Array


@dataclass(frozen=True)
class Verdict:
    """
    The judgement: `reasons` why the goal was missed; `rows` name, planned, achieved.

    `undecided` says why it cannot be told whether the goal would have been reached and held: what
    was measured ends too early, all being well until then; '' if it can be told.
    """

    reasons: tuple[str, ...]
    rows: tuple[tuple[str, str, str], ...]
    undecided: str = ''

    @property
    def reached(self) -> bool:
        """Whether the goal was reached and held within all limits."""
        return not self.reasons and not self.undecided


def ends_early(end: float) -> str:
    """Say that what was measured ends `end` s after the start of the motion, too early."""
    return (
        f'the recording ends at {end:.1f} s, before the goal could be reached and held for '
        f'{HOLD_TIME:g} s'
    )


def held_from(times: Array, error: Array, tolerance: float) -> float:
    """Return the earliest instant [s] from which |error| stays within `tolerance`; inf if none."""
    outside = np.flatnonzero(~(np.abs(error) < tolerance))
    if outside.size == 0:
        return float(times[0]) if times.size else math.inf
    last = int(outside[-1])
    return float(times[last + 1]) if last + 1 < times.size else math.inf


def planned_instants(plan: Trajectory) -> Array:
    """Return instants (n,) s, from 0 on, at which a plan is judged like what was measured."""
    return np.linspace(0.0, plan.duration, min(int(plan.duration / _STEP) + 2, _MOST_STEPS))


def _from_upright(theta: Array) -> Array:
    """Return angles (n,) from the upright position that they end near."""
    return np.asarray(theta - 2 * math.pi * np.round(theta[-1] / (2 * math.pi)))


def judge_pendulum(
    plan: Trajectory,
    measured: MeasuredPendulum,
    torque_limit: float,
    disk_limit: float,
    solve_time: float,
) -> Verdict:
    """Judge a swing-up: upright within `LONGEST_CATCH` s of the planned end and held after it."""
    error = _from_upright(measured.theta)
    instants = planned_instants(plan)
    theta = plan.sample(instants).state[:, plan.state_names.index('theta')]
    due = held_from(instants, _from_upright(theta), UPRIGHT_TOLERANCE)
    since = held_from(measured.times, error, UPRIGHT_TOLERANCE)
    last = measured.times > measured.times[-1] - HOLD_TIME
    held = float(measured.times[-1]) - max(since, 0.0)
    landing = int(np.argmin(np.abs(measured.times - plan.duration)))
    disk, torque = float(np.abs(measured.psi).max()), float(np.abs(measured.torque).max())
    planned_torque = float(np.abs(plan.control('torque')).max())
    planned_disk = float(np.abs(plan.state('psi')).max())
    end, reasons = float(measured.times[-1]), []
    late = not since <= plan.duration + LONGEST_CATCH
    if late and end > plan.duration + LONGEST_CATCH:
        reasons.append(
            f'the pendulum was not upright within {LONGEST_CATCH:g} s of the planned end'
        )
    undecided = not reasons and (late or held < HOLD_TIME)
    if not disk < disk_limit:
        reasons.append(f'the disk reached {disk:.3f} rad, its limit is {disk_limit:g} rad')
    if not torque <= torque_limit * (1 + 1e-9):
        reasons.append(f'the torque reached {torque:.4g} N m, its limit is {torque_limit:g} N m')
    worst_hold = float(np.abs(error[last]).max())
    rows = (
        ('duration of the plan [s]', f'{plan.duration:.3f}', ''),
        (f'upright within {UPRIGHT_TOLERANCE:g} rad from [s]', f'{due:.3f}',
         f'{max(since, 0.0):.3f}'),
        ('peak torque [N m]', f'{planned_torque:.4f}', f'{torque:.4f}'),
        ('torque margin [N m]', f'{torque_limit - planned_torque:.4f}',
         f'{torque_limit - torque:.4f}'),
        ('largest disk angle [rad]', f'{planned_disk:.3f}', f'{disk:.3f}'),
        ('disk angle margin [rad]', f'{disk_limit - planned_disk:.3f}',
         f'{disk_limit - disk:.3f}'),
        ('landing error theta [rad]', '0', f'{error[landing]:+.4f}'),
        ('landing error theta_dot [rad/s]', '0', f'{measured.theta_dot[landing]:+.3f}'),
        ('held for [s]', f'>= {HOLD_TIME:g}', f'{max(held, 0.0):.1f}'),
        ('worst angle at the end [rad]', f'< {UPRIGHT_TOLERANCE:g}', f'{worst_hold:.4f}'),
        ('time to solve [ms]', f'{1e3 * solve_time:.0f}', ''),
    )  # fmt: skip
    return Verdict(tuple(reasons), rows, ends_early(end) if undecided and not reasons else '')

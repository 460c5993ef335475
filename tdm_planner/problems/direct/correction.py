# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The correction of a collocated motion, so that whoever integrates its controls ends at the goal.

Collocation leaves a small defect d_k in every interval: the plant, integrated from node k, misses
node k + 1. Where it is unstable the defects grow exponentially until the end. A step of Newton's
method in the sense of multiple shooting removes them. With the plant linearised in every interval,

    dx_(k+1) = Phi_k dx_k + d_k + B_k du,    dx_0 = 0,    dx_n = 0 where the end is given,

it takes the least change du of controls and duration, in units of what is left to the limits. As
every interval is linearised about its own nodes, it converges however unstable the plant is. See
Bock and Plitt, *A multiple shooting algorithm for direct solution of optimal control problems*,
1984.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from tdm_planner.direct_method.collocation import Ends, Motion
from tdm_planner.problems.direct.plant import DirectPlant

Array = NDArray[np.float64]

_PACE = 1e-2  # share of the duration that counts as much as what is left to a control
_FAR = 0.5  # units of room that controls may use up while the duration stays
_LEAST, _TINY = 1e-5, 1e-12  # share of a control that is left where nothing is; at least


@np.errstate(all='ignore')
def corrected(
    plant: DirectPlant,
    motion: Motion,
    ends: Ends,
    durations: tuple[float, float],
    tolerance: Array,
) -> Motion | None:
    """
    Return the motion with its defects removed, to first order; None where limits are in the way.

    `durations` are the shortest and the longest [s]; `tolerance` (nx,) is the unit of errors at
    the end. Raises numpy's LinAlgError where the limits' slopes are out of all proportion.
    """
    x, u, m = motion.states, motion.controls, motion.middles
    n, nx, nu = motion.intervals, x.shape[1], u.shape[1]
    h, middle_u = np.diff(motion.times)[:, None, None], 0.5 * (u[:-1] + u[1:])

    def mean(at_ends: Array, in_middles: Array) -> Array:
        return (at_ends[:-1] + 4.0 * in_middles + at_ends[1:]) / 6.0

    # The state, controls, their rates, and a disturbance that lasts: by the first term of Magnus.
    nw = nx + nu  # of states and controls
    system = np.zeros((n, nw + nu + 1, nw + nu + 1))
    slopes_of = zip(plant.jacobians(x, u), plant.jacobians(m, middle_u), strict=True)
    system[:, :nx, :nx], system[:, :nx, nx:nw] = (mean(*pair) for pair in slopes_of)
    system[:, :nx, -1] = mean(plant.rates(x, u), plant.rates(m, middle_u))
    system[:, nx:nw, nw:-1] = np.eye(nu)
    grown = expm(np.nan_to_num(system * h, posinf=0.0, neginf=0.0))[:, :nx]  # at rest, 0 / 0
    transition, by_last = grown[..., :nx], grown[..., nw:-1] / h
    by_first = grown[..., nx:nw] - by_last
    by_duration = grown[..., -1:] / motion.duration
    defects = plant.stepped(x[:-1], u[:-1], u[1:], h[:, 0]) - x[1:]

    # Slopes of the end by every control and by the duration, and what the end is missed by.
    of_controls, of_duration = np.zeros((nx, n + 1, nu)), np.zeros((nx, 1))
    miss, rest = np.zeros(nx), np.eye(nx)
    for k in reversed(range(n)):
        of_controls[:, k] += rest @ by_first[k]
        of_controls[:, k + 1] += rest @ by_last[k]
        of_duration += rest @ by_duration[k]
        miss += rest @ defects[k]
        rest = rest @ transition[k]

    left, _, by_control = plant.linear_limits(motion.times, x, u)
    room = _room(left, by_control, np.abs(u).max(axis=0))
    for side in (0, -1):
        room[side, np.isfinite(ends.controls[side])] = 0.0
    shortest, longest = durations
    pace = min(_PACE * motion.duration, motion.duration - shortest, longest - motion.duration)
    of_room = (of_controls[:, :, None] @ room).reshape(nx, -1)
    slopes = np.hstack([of_room, pace * of_duration])
    given = np.isfinite(ends.states[1])
    missed = ((ends.states[1] - x[-1] - miss) / tolerance)[given]
    rows = (slopes / tolerance[:, None])[given]
    if not (np.isfinite(rows).all() and np.isfinite(missed).all()):
        return None
    # Another duration moves all instants, by up to a nanosecond: only where it must be.
    change = np.append(np.linalg.lstsq(rows[:, :-1], missed, rcond=None)[0], 0.0)
    if np.linalg.norm(change) > _FAR:
        change = np.linalg.lstsq(rows, missed, rcond=None)[0]
    if np.linalg.norm(change) > 1.0:
        return None
    du, longer = (room @ change[:-1].reshape(n + 1, nu, 1))[..., 0], pace * float(change[-1])
    moved = np.zeros_like(x)
    for k in range(n):
        moved[k + 1] = transition[k] @ moved[k] + defects[k] + by_duration[k, :, 0] * longer
        moved[k + 1] += by_first[k] @ du[k] + by_last[k] @ du[k + 1]
    middles = m + 0.5 * (moved[:-1] + moved[1:])
    return Motion(x + moved, middles, u + du, motion.duration + longer)


def _room(margins: Array, slopes: Array, sizes: Array) -> Array:
    """
    Return the changes of controls (N, nu, nu) that are one unit, column by column.

    With margins (N, nm), their slopes by the controls (N, nm, nu) and the controls' `sizes` (nu,)
    they are the axes of Dikin's ellipsoid, within which limits are kept.
    """
    sizes = sizes + _TINY
    slopes = np.nan_to_num(slopes * sizes, posinf=0.0, neginf=0.0)
    left = np.maximum(np.nan_to_num(margins), _LEAST * np.linalg.norm(slopes, axis=2) + _TINY)
    scaled = slopes / left[..., None]
    axes = np.linalg.cholesky(np.eye(sizes.size) + np.swapaxes(scaled, 1, 2) @ scaled)
    return np.asarray(sizes[:, None] * np.swapaxes(np.linalg.inv(axes), 1, 2))

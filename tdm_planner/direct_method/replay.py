# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The replay of a collocated motion: from its first state, controls linear in every interval."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.collocation import Motion
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.tracing import Trace

Array = NDArray[np.float64]


class Replay:
    """
    A motion integrated from its first state, controls linear: to look before the check proper.

    By `SUBSTEPS` Runge-Kutta steps an interval, all of it compiled.
    """

    SUBSTEPS = 6

    def __init__(self, trace: Trace, intervals: int) -> None:
        nx, nu = trace.rates.size1_in(0), trace.rates.size1_in(1)
        x, h = ca.SX.sym('x', nx), ca.SX.sym('h')
        first, last = ca.SX.sym('a', nu), ca.SX.sym('b', nu)
        p = ca.SX.sym('p', trace.rates.size1_in(2))
        state, found, step = x, [], h / self.SUBSTEPS
        for part in range(self.SUBSTEPS):
            shares = ((part + share) / self.SUBSTEPS for share in (0.0, 0.5, 1.0))
            u0, um, u1 = (first + (last - first) * share for share in shares)
            k1 = trace.rates(state, u0, p)
            k2 = trace.rates(state + step / 2 * k1, um, p)
            k3 = trace.rates(state + step / 2 * k2, um, p)
            k4 = trace.rates(state + step * k3, u1, p)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            found.append(state)
        one = ca.Function('step', [x, first, last, h, p], [state, ca.vertcat(*found)])
        self._all = one.mapaccum('replay', intervals)
        self._intervals, self._trace = intervals, trace

    @classmethod
    def of(cls, trace: Trace, intervals: int) -> Replay:
        """Return the replay of this kind, made once."""
        return trace.once((cls, intervals), lambda: cls(trace, intervals))

    def __call__(self, motion: Motion, numbers: Array) -> tuple[Array, Array, Array]:
        """Return times (N,), states (N, nx) and controls (N, nu) at all substeps."""
        n, k = self._intervals, self.SUBSTEPS
        u, p = motion.controls, np.tile(numbers[:, None], (1, n))
        steps = np.full((1, n), motion.duration / n)
        _, inside = self._all(motion.states[0], u[:-1].T, u[1:].T, steps, p)
        states = np.asarray(inside).T.reshape(n * k, -1)
        times = np.linspace(0.0, motion.duration, n * k + 1)
        share = np.tile(np.arange(k) / k, n)[:, None]
        controls = np.repeat(u[:-1], k, axis=0) * (1 - share) + np.repeat(u[1:], k, axis=0) * share
        return times, np.vstack([motion.states[0], states]), np.vstack([controls, u[-1]])

    def worst(self, times: Array, states: Array, controls: Array, numbers: Array) -> Array:
        """Return the least margins (nm,), also between the substeps, on cubics through them."""
        parts = 5
        count = times.size
        rates = Call(self._trace.rates, count)(states, controls, numbers)[0].copy()
        h, share = np.diff(times)[:, None, None], (np.arange(parts) / parts)[None, :, None]
        a, b = states[:-1, None], states[1:, None]
        fa, fb = rates[:-1, None], rates[1:, None]
        cubic = (1 - share) ** 2 * ((1 + 2 * share) * a + share * h * fa)
        cubic = cubic + share**2 * ((3 - 2 * share) * b + (share - 1) * h * fb)
        linear = (1 - share) * controls[:-1, None] + share * controls[1:, None]
        t = (times[:-1, None] + np.diff(times)[:, None] * share[0, :, 0]).ravel()
        t = np.append(t, times[-1])[:, None]
        x = np.vstack([cubic.reshape(-1, states.shape[1]), states[-1:]])
        u = np.vstack([linear.reshape(-1, controls.shape[1]), controls[-1:]])
        margins = Call(self._trace.margins, t.size)(t, x, u, numbers)[0]
        return np.asarray(margins.min(axis=0)) if margins.size else np.zeros(0)


def cost_along(
    trace: Trace, numbers: Array, times: Array, states: Array, controls: Array
) -> float:
    """Return J of a motion given at the ends and in the middle of intervals, (2 n + 1, ...)."""
    rows = Call(trace.running, times.size)(times[:, None], states, controls, numbers)[0][:, 0]
    pairs = rows[:-2:2] + 4.0 * rows[1::2] + rows[2::2]  # Simpson's rule
    final = Call(trace.final)(times[-1], states[-1], numbers)[0]
    return float((times[2::2] - times[:-2:2]) @ pairs / 6.0 + final[0])

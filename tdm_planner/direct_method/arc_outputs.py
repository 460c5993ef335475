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

"""Time and outputs along the virtual arc as functions of the varied parameters Xi."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bernstein import bernstein_basis, bernstein_integral
from tdm_planner.direct_method.formulation import Duration, Output
from tdm_planner.direct_method.output_basis import OrthonormalBasis, output_basis
from tdm_planner.direct_method.virtual_domain import (
    candidate_arc_derivatives,
    candidate_time_derivatives,
    reciprocal,
)

Array = NDArray[np.float64]
Values = NDArray[Any]


@dataclass(frozen=True, eq=False)
class _Tabulated:
    """An output's basis at the points of the arc, derivative by derivative."""

    output: Output
    basis: OrthonormalBasis
    given: list[Array]
    varied: list[Array]
    scale: float


class ArcOutputs:
    """
    mu = dt/ds, t, and the outputs' derivatives by time at `points` (P,) of the unit interval.

    The first elements of Xi are the coefficients of mu in units of the guessed duration, unless
    that is fixed; then come the free parameters of every output in units of its scale.
    """

    def __init__(self, outputs: Mapping[str, Output], duration: Duration, points: Array) -> None:
        self.duration = duration
        self.degree = duration.speed_factor_order
        self._points = points
        self._outputs = self._tabulate(outputs)
        self._rates = 1 + max(_highest_derivative(output) for output in outputs.values())
        timing = 0 if duration.fixed else self.degree + 1
        sizes = [timing, *(tabulated.basis.size for tabulated in self._outputs.values())]
        self._slices = np.cumsum([0, *sizes])

    @property
    def size(self) -> int:
        """Return the number of varied parameters."""
        return int(self._slices[-1])

    @property
    def timing(self) -> slice:
        """Where in Xi the coefficients of mu are."""
        return slice(0, int(self._slices[1]))

    def values(self, xi: Values) -> tuple[Values, Values, dict[str, list[Values]]]:
        """Return mu, t (B, P) and the outputs' derivatives by time, (B, P) each, of Xi (B, n)."""
        mu, times = self._time(xi, self._points)
        ends, _ = self._time(xi, np.array([0.0, 1.0]))
        values = {}
        for (name, tabulated), first, last in zip(
            self._outputs.items(), self._slices[1:-1], self._slices[2:], strict=True
        ):
            given = self._boundary_values(tabulated.output, ends, len(xi))
            free = tabulated.scale * xi[:, first:last]
            jet = [
                given @ fixed.T + free @ varied.T
                for fixed, varied in zip(tabulated.given, tabulated.varied, strict=True)
            ]
            if self.degree == 0:
                values[name] = [value / mu[0] ** order for order, value in enumerate(jet)]
            else:
                values[name] = candidate_time_derivatives(
                    jet, reciprocal(mu[: max(1, len(jet) - 1)])
                )
        return mu[0], times, values

    def _time(self, xi: Values, s: Array) -> tuple[list[Values], Values]:
        """Return mu and its derivatives by s, and t, at s (P,): (B, P) each."""
        coefficients = self._coefficients(xi)
        rates = [
            coefficients @ bernstein_basis(self.degree, s, order).T for order in range(self._rates)
        ]
        return rates, coefficients @ bernstein_integral(self.degree, s).T

    def _coefficients(self, xi: Values) -> Values:
        guess = self.duration.guess
        if self.duration.fixed:
            return np.full((len(xi), 1), guess)
        return np.asarray(guess * xi[:, self.timing])

    def _boundary_values(self, output: Output, mu: list[Values], count: int) -> Values:
        """Return the derivatives by s at both ends from those by time, (B, mg)."""
        columns = []
        for side, where in enumerate(('start', 'end')):
            given = output.conditions(where)
            at = [rate[:, side] for rate in mu]
            if self.degree == 0:
                found = {order: value * at[0] ** order for order, value in given.items()}
            else:
                size = max(given, default=-1) + 1
                jet = [np.full(count, given.get(order, 0.0)) for order in range(size)]
                speed = reciprocal(at)
                found = dict(enumerate(candidate_arc_derivatives(jet, speed))) if jet else {}
            columns += [np.broadcast_to(found[order], count) for order in given]
        return np.stack(columns, axis=-1) if columns else np.zeros((count, 0))

    def _tabulate(self, outputs: Mapping[str, Output]) -> dict[str, _Tabulated]:
        scales = {name: self._scale(output) for name, output in outputs.items()}
        largest = max(scales.values()) or 1.0
        tables = {}
        for name, output in outputs.items():
            basis = output_basis(name, output, self.degree)
            orders = range(output.derivatives + 1)
            tables[name] = _Tabulated(
                output,
                basis,
                [basis.given(self._points, order) for order in orders],
                [basis.varied(self._points, order) for order in orders],
                scales[name] or largest,
            )
        return tables

    def _scale(self, output: Output) -> float:
        """Return a typical change of an output along the arc."""
        if output.scale is not None:
            return output.scale
        start, end = output.conditions('start'), output.conditions('end')
        sizes = [abs(end.get(0, 0.0) - start.get(0, 0.0))]
        for given in (start, end):
            sizes += [abs(v) * self.duration.guess**k for k, v in given.items() if k > 0]
        return max(sizes)


def _highest_derivative(output: Output) -> int:
    given = [*output.conditions('start'), *output.conditions('end')]
    return max(output.derivatives, *given, 0)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The virtual arc as matrices: everything at a node is linear in the varied parameters but one part.

At a point s of the unit interval let w = (mu, mu', ..., t, X, X', X'', ... of every output), with
mu = dt/ds. Then w = table(s) (c, b, a): c the coefficients of mu, a the free parameters of the
outputs, and b the boundary values by s, which alone are a nonlinear function, of c. What is stated
is a graph of one w. The motion at the nodes is checked for numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.bases import (
    arc_derivatives,
    basis_of,
    bernstein_basis,
    OutputBasis,
    reciprocal,
    time_derivatives,
)
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Duration, Output
from tdm_planner.direct_method.graphs import Call, Differentiated
from tdm_planner.direct_method.hints import ARGUMENTS
from tdm_planner.direct_method.tracing import numbers, Trace
from tdm_planner.exceptions import InvalidProblem, NotFinite

_PLACES = {  # of functions that are not called along the whole arc
    'final_cost': slice(-1, None),
    'start_conditions': slice(0, 1),
    'end_conditions': slice(-1, None),
}
_ROUNDING = 1e-9  # share by which a state passed on may differ from itself


@dataclass(frozen=True)
class ArcLayout:
    """
    What stands where in w: `orders` of the outputs' highest derivatives, the `degree` of mu.

    `given` holds the orders of the boundary values of every output at start and end.
    """

    names: tuple[str, ...]
    orders: tuple[int, ...]
    given: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    degree: int

    @classmethod
    def of(cls, outputs: Mapping[str, Output], duration: Duration) -> ArcLayout:
        """Return the layout of these outputs."""
        ends = [
            (tuple(output.conditions('start')), tuple(output.conditions('end')))
            for output in outputs.values()
        ]
        orders = tuple(output.derivatives for output in outputs.values())
        return cls(tuple(outputs), orders, tuple(ends), duration.speed_factor_order)

    @property
    def rates(self) -> int:
        """Return how many derivatives of mu are needed, mu itself among them."""
        return max(1, *self.orders) if self.degree else 1

    @property
    def size(self) -> int:
        """Return the number of elements of w."""
        return self.rates + 1 + sum(order + 1 for order in self.orders)

    def read(self, w: Any) -> tuple[Any, Any, dict[str, list[Any]]]:
        """Return mu, t, and the outputs' derivatives by time, from the symbols w."""
        constant = (max(1, *self.orders) - self.rates) * [0.0]
        factor = reciprocal([*(w[i] for i in range(self.rates)), *constant])
        at, found = self.rates + 1, {}
        for name, order in zip(self.names, self.orders, strict=True):
            found[name] = time_derivatives([w[at + k] for k in range(order + 1)], factor)
            at += order + 1
        return w[0], w[self.rates], found


@lru_cache(maxsize=64)
def boundary_values(layout: ArcLayout) -> Differentiated:
    """Return b (c; boundary values by time), in the order of the outputs, start before end."""
    c = ca.SX.sym('c', layout.degree + 1)
    given, found = [], []
    for ends in layout.given:
        for side, orders in zip((0.0, 1.0), ends, strict=True):
            values = [ca.SX.sym('v') for _ in orders]
            given += values
            size = max(orders, default=-1) + 1
            basis = [bernstein_basis(layout.degree, side, k) for k in range(max(size, 1))]
            mu = [(ca.SX(row[None]) @ c)[0] for row in basis]
            known = dict(zip(orders, values, strict=True))
            if orders:
                jet = [known.get(k, ca.SX(0)) for k in range(size)]
                by_arc = arc_derivatives(jet, reciprocal(mu))
                found += [by_arc[k] for k in orders]
    column = [ca.vertcat(ca.SX(0, 1), *values) for values in (given, found)]
    return Differentiated('boundary', c, *column)


class ArcBasis:
    """
    The table (P, nw, nc + nb + na) of an arc at `points` (P,), and what Xi means.

    Xi holds the coefficients of mu in units of the guessed duration, unless that is fixed, then
    the free parameters of every output in units of its scale.
    """

    def __init__(self, outputs: Mapping[str, Output], duration: Duration, points: Array) -> None:
        self.duration = duration
        self.layout = layout = ArcLayout.of(outputs, duration)
        self.boundary = boundary_values(layout)
        self._boundary_call = Call(self.boundary.value)
        self.given = np.array(
            [
                value
                for output in outputs.values()
                for where in ('start', 'end')
                for value in output.conditions(where).values()
            ]
        )
        self.nc, self.nb = layout.degree + 1, self.given.size
        bases = {name: output_basis(name, o, layout.degree) for name, o in outputs.items()}
        scales = {name: _scale(output, duration) for name, output in outputs.items()}
        largest = max(scales.values()) or 1.0
        self.scales = {name: scale or largest for name, scale in scales.items()}
        self.bases = bases
        self.free = {name: basis.size for name, basis in bases.items()}
        self.timing = 0 if duration.fixed else self.nc
        self.size = self.timing + sum(self.free.values())
        self.is_linear = not (self.timing and self.nb)  # else boundary values depend on mu
        self.table = self._table(outputs, points)

    def _table(self, outputs: Mapping[str, Output], points: Array) -> Array:
        layout, degree = self.layout, self.layout.degree
        columns = self.nc + self.nb + sum(self.free.values())
        table = np.zeros((points.size, layout.size, columns))
        for order in range(layout.rates):
            table[:, order, : self.nc] = bernstein_basis(degree, points, order)
        table[:, layout.rates, : self.nc] = bernstein_basis(degree, points, -1)
        row, b, a = layout.rates + 1, self.nc, self.nc + self.nb
        for name, output in outputs.items():
            basis = self.bases[name]
            nb, na = len(basis.start) + len(basis.end), basis.size
            last_b, last_a = b + nb, a + na
            for order in range(output.derivatives + 1):
                given, varied = _sampled(basis, points.tobytes(), order)
                table[:, row + order, b:last_b] = given
                table[:, row + order, a:last_a] = self.scales[name] * varied
            row, b, a = row + output.derivatives + 1, last_b, last_a
        return table

    def _coefficients(self, xi: Array) -> Array:
        """Return c (nc,), the coefficients of mu [s]."""
        return self.duration.guess * (xi[: self.timing] if self.timing else np.ones(1))

    def values(self, xi: Array) -> Array:
        """Return w at the points, (P, nw)."""
        c = self._coefficients(xi)
        b = self._boundary_call(c, self.given)[0] if self.nb else np.zeros(0)
        return np.asarray(self.table @ np.concatenate([c, b, np.split(xi, [self.timing])[1]]))

    def slopes(self, xi: Array) -> Array:
        """Return the derivatives of w by Xi, (P, nw, n)."""
        nc, nb, guess = self.nc, self.nb, self.duration.guess
        _, of_boundary, free = np.split(self.table, [nc, nc + nb], axis=2)
        slopes = np.concatenate([guess * self.table[:, :, : self.timing], free], axis=2)
        if not self.is_linear:
            _, slope = Call(self.boundary.linear)(self._coefficients(xi), self.given)
            slopes[:, :, :nc] += of_boundary @ (guess * slope.reshape(nb, nc))
        return slopes

    def curvature(self, xi: Array, multipliers: Array) -> Array:
        """Return the Hessian (nc, nc) of the sum of `multipliers` (P, nw) times w."""
        _, of_boundary, _ = np.split(self.table, [self.nc, self.nc + self.nb], axis=2)
        of_b = np.einsum('kw,kwb->b', multipliers, of_boundary)
        bent = Call(self.boundary.second)(self._coefficients(xi), self.given, of_b)[0]
        return np.asarray(self.duration.guess**2 * bent.reshape(self.nc, self.nc))


def output_basis(name: str, output: Output, speed_factor_order: int) -> OutputBasis:
    """
    Return the basis of an output.

    Raise InvalidProblem, naming the output, if its conditions contradict each other, leave no
    function, or cannot be converted to the virtual arc.
    """
    start, end = tuple(output.conditions('start')), tuple(output.conditions('end'))
    for where, given in (('start', start), ('end', end)):
        positive = [order for order in given if order > 0]
        if speed_factor_order and positive and set(positive) != set(range(1, max(positive) + 1)):
            raise InvalidProblem(
                f"output '{name}' has derivatives {sorted(given)} given at the {where}: with a "
                'speed factor all lower ones must be given too'
            )
    try:
        return basis_of(output.shapes, start, end, output.free)
    except InvalidProblem as error:
        raise InvalidProblem(f"output '{name}': {error}") from None


@lru_cache(maxsize=256)
def _sampled(basis: OutputBasis, points: bytes, order: int) -> tuple[Array, Array]:
    """Return the shapes of the given conditions and the free ones: nodes are mostly the same."""
    s = np.frombuffer(points)
    return basis.given(s, order), basis.varied(s, order)


def _scale(output: Output, duration: Duration) -> float:
    """Return a typical change of an output along the arc."""
    if output.scale is not None:
        return output.scale
    start, end = output.conditions('start'), output.conditions('end')
    sizes = [abs(end.get(0, 0.0) - start.get(0, 0.0))]
    for given in (start, end):
        sizes += [abs(v) * duration.guess**k for k, v in given.items() if k > 0]
    return max(sizes)


class NodeGraphs:
    """
    The graphs of a node: from w (see `ArcBasis`) and the integrated states z to all values.

    `motion` gives states and controls, `node` the integrand of J by s and the margins, `start`
    and `end` the conditions there (`end` after the final cost), `step` a Runge-Kutta step of z.
    """

    def __init__(self, trace: Trace, layout: ArcLayout, stated: CheckedFormulation) -> None:
        names = list(stated.integrated())
        w, z = ca.SX.sym('w', layout.size), ca.SX.sym('z', len(names))
        p = ca.SX.sym('p', trace.invert.numel_in(2))
        mu, t, y = layout.read(w)
        wz = ca.vertcat(w, z)
        jets = ca.vertcat(*(value for jet in y.values() for value in jet))
        both = trace.invert(jets, z, p)
        x, u = ca.vertsplit(both, [0, len(stated.state_names), both.numel()])
        self.motion = ca.Function('motion', [wz, p], [both])
        rows = ca.vertcat(trace.running(t, x, u, p) * mu, trace.margins(t, x, u, p))
        ends = ca.vertcat(trace.final(t, x, p), trace.end_conditions(t, x, p))
        self.node = Differentiated('node', wz, p, rows)
        self.start = Differentiated('start', wz, p, trace.start_conditions(t, x, p))
        self.end = Differentiated('end', wz, p, ends)
        self.starts, self.ends = int(trace.start_conditions.numel_out()), int(ends.numel()) - 1
        if not names:
            return
        index = [stated.state_names.index(name) for name in names]
        rate = ca.Function('rate', [w, z, p], [trace.rates(x, u, p)[index] * mu])
        here, middle, there = (ca.SX.sym(name, layout.size) for name in 'amb')
        h = ca.SX.sym('h')
        k1 = rate(here, z, p)
        k2 = rate(middle, z + h / 2 * k1, p)
        k3 = rate(middle, z + h / 2 * k2, p)
        k4 = rate(there, z + h * k3, p)
        following = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        arguments = ca.vertcat(here, middle, there, z), ca.vertcat(p, h)
        self.step = Differentiated('step', *arguments, following)

    @classmethod
    def of(cls, trace: Trace, layout: ArcLayout, stated: CheckedFormulation) -> NodeGraphs:
        """Return the graphs of this kind, made once."""
        return trace.once(layout, lambda: cls(trace, layout, stated))


class ArcMotion(NamedTuple):
    """A candidate at K nodes: times (K,), states (K, nx), controls (K, nu)."""

    times: Array
    states: Array
    controls: Array


def check_finite(stated: CheckedFormulation, motion: ArcMotion, nodes: Array) -> None:
    """
    Raise NotFinite for the first node of a motion where something is not finite.

    What is wrong there spoils the integration of all that follow. The message names function,
    node and value.
    """
    last, along = nodes.size - 1, dict(zip('txu', motion, strict=True))
    found = []
    for function, names in ARGUMENTS.items():
        at = _PLACES.get(function, slice(None))
        if function == 'invert':
            given = stated.called(motion.states, motion.controls)
            for name in stated.integrated():  # these are wrong because their rates are
                del given[f"state '{name}'"]
        else:
            given = stated.values(function, *(along[name][at] for name in names))
        for what, values in given.items():
            if not np.isfinite(values).all():
                node = last if at.start == -1 else int(np.argmin(np.isfinite(values)))
                found.append((node, f'{function} gives {what}', values))
    if found:
        node, what, values = min(found, key=lambda item: item[0])
        remedy = 'or near it (`first_guess` gives another)'
        if node == 0 or (node == last and not stated.integrated()):
            remedy = 'but the boundary values fix it there: is it 0 / 0 at rest?'
        for name, value in numbers(stated.formulation).items():
            if not np.isfinite(value).all():
                remedy = f"but the parameter '{name}' = {value[~np.isfinite(value)][0]}"
        raise NotFinite(
            f'{what} = {values[0 if values.size == 1 else node]} at node {node} of {nodes.size} '
            f'(s = {nodes[node]:.3g}, t = {motion.times[node]:.3g} s): it must be a '
            f'number along the initial guess, {remedy}'
        )


def check_integrated(
    stated: CheckedFormulation, motion: ArcMotion, integrated: Array, nodes: Array
) -> None:
    """
    Raise InvalidProblem where `invert` gives other states than the `integrated` ones (K, nz).

    The message names state, node and both values.
    """
    for name, expected in zip(stated.integrated(), integrated.T, strict=True):
        given = motion.states[:, stated.state_names.index(name)]
        size = float(np.abs(expected).max())
        same = np.isclose(given, expected, rtol=_ROUNDING, atol=_ROUNDING * size, equal_nan=True)
        if not same.all():
            node = int(np.argmin(same))
            raise InvalidProblem(
                f"invert gives the state '{name}' = {given[node]:g} at node {node} of "
                f'{nodes.size} (s = {nodes[node]:.3g}), but integrated gives {expected[node]:g}: '
                f"it must be z['{name}'], or not be integrated"
            )

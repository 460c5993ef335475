# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A formulation as the nonlinear program (10) in the scaled varied parameters Xi.

Xi holds the duration (or the coefficients of the speed factor's dt/ds) in units of the first
guess, then the free parameters of every output in units of its scale. Along the arc, s in [0, 1]:

    X(s) = given(s) b(Xi) + varied(s) a,   d/dt = (1/mu) d/ds,   t(s) = integral of mu,

with b the boundary values converted exactly to derivatives by s; states and controls by
`Formulation.invert`, integrated states by the classical Runge-Kutta method from node to node,
J by Clenshaw-Curtis quadrature. Many candidates are computed at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.bernstein import bernstein_basis, bernstein_integral
from tdm_planner.direct_method.differentiation import choose_scheme, jacobians, Scheme
from tdm_planner.direct_method.formulation import components, Formulation, Output, stack
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.output_basis import OrthonormalBasis, output_basis
from tdm_planner.direct_method.virtual_domain import (
    arc_derivatives,
    reciprocal,
    time_derivatives,
)
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]
Values = NDArray[Any]

_NEAR = 1.0  # margin within which a node gets a row
_HESSIAN_STEP = 1e-5
_LEAST_CURVATURE = 1e-4


@dataclass(frozen=True, eq=False)
class ArcMotion:
    """B candidates at K nodes: times (B, K), states (B, K, nx), controls (B, K, nu), rate mu."""

    times: Values
    states: Values
    controls: Values
    rate: Values


@dataclass(frozen=True, eq=False)
class _Tabulated:
    """An output's basis at the points of the arc, derivative by derivative."""

    output: Output
    basis: OrthonormalBasis
    given: list[Array]
    varied: list[Array]
    scale: float


def chebyshev_nodes(count: int) -> Array:
    """Return `count` Chebyshev-Lobatto nodes on the unit interval."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))


def quadrature_weights(nodes: Array) -> Array:
    """Return weights (K,) that integrate polynomials through Chebyshev-Lobatto `nodes`."""
    count = nodes.size
    k = np.arange(count)
    modes = np.cos(np.pi * np.outer(k, k) / (count - 1))
    moments = np.where(k % 2 == 0, 1.0 / (1.0 - np.where(k % 2 == 0, k, 0) ** 2.0), 0.0)
    return np.linalg.solve(modes, moments)


class Transcription(NonlinearProgram):
    """The program of a formulation on the given `nodes` (K,), from 0 to 1.

    `reserve` is what must be left to a limit, by name, at the nodes between the ends. Group 0 of
    the constraints are equalities (ends of integrated states, end conditions), group 1 margins.

    Raises
    ------
    InvalidProblem
        For boundary conditions that contradict each other, components that do not match the
        names, or a performance index that is not stated.
    """

    def __init__(
        self, formulation: Formulation, nodes: Array, reserve: Mapping[str, float] | None = None
    ) -> None:
        self.formulation = formulation
        self.nodes = nodes
        self.reserve = dict(reserve or {})
        self.evaluations = 0
        self.cost_scale = 1.0
        self._equality_count = 0
        self.integrated = dict(formulation.integrated())
        unknown = set(self.integrated) - set(formulation.state_names)
        if unknown:
            raise InvalidProblem(
                f"integrated state '{unknown.pop()}' is not one of the states "
                + ', '.join(formulation.state_names)
            )
        self._duration = formulation.duration()
        self._degree = self._duration.speed_factor_order
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        self._points = np.sort([*nodes, *middles]) if self.integrated else nodes
        self._stride = 2 if self.integrated else 1
        self._outputs = self._tabulate()
        self._weights = quadrature_weights(chebyshev_nodes(nodes.size))
        timing = 0 if self._duration.fixed else self._degree + 1
        sizes = [timing, *(tabulated.basis.size for tabulated in self._outputs.values())]
        self._slices = np.cumsum([0, *sizes])
        shortest, longest = self._duration.bounds
        self.lower = np.full(sum(sizes), -1e3)
        self.upper = np.full(sum(sizes), 1e3)
        self.lower[:timing] = shortest / self._duration.guess
        self.upper[:timing] = longest / self._duration.guess
        self.scheme: Scheme = 'complex_step'

    @property
    def size(self) -> int:
        """Number of varied parameters."""
        return int(self.lower.size)

    @property
    def first_guess(self) -> Array:
        """The guessed duration, and nothing beside the boundary conditions."""
        xi = np.zeros(self.size)
        xi[: self._slices[1]] = 1.0
        return xi

    def begin(self, xi: Array) -> None:
        """Scale the cost and choose the scheme of differentiation at a first point (n,).

        Raises
        ------
        InvalidProblem
            Naming function, node and value, if something is not a finite number there.
        """
        with np.errstate(all='ignore'):
            self._check_finite(self.motion(xi[None]))
            self.cost_scale = 1.0
            cost = abs(float(self._values(xi[None])[0, 0]))
            self.cost_scale = cost if cost > 1e-9 else 1.0
            self.scheme = choose_scheme(self._values, xi)

    def refine(self, nodes: Array, reserve: Mapping[str, float]) -> Transcription:
        """Return the program on other nodes, scaled and differentiated alike."""
        other = Transcription(self.formulation, nodes, reserve)
        other.cost_scale, other.scheme = self.cost_scale, self.scheme
        return other

    def motion(self, xi: Values) -> ArcMotion:
        """Motion of candidates (B, n) at the nodes."""
        mu, times = self._timing(xi, self._points)
        y = self._output_values(xi, mu)
        every = slice(None, None, self._stride)
        z = self._integrate(y, mu[0]) if self.integrated else {}
        at_nodes = {name: [value[:, every] for value in jet] for name, jet in y.items()}
        states, controls = self._invert(at_nodes, z)
        return ArcMotion(times[:, every], states, controls, mu[0][:, every])

    def cost(self, motion: ArcMotion) -> Values:
        """Return J of the candidates, (B,)."""
        form, x, u = self.formulation, components(motion.states), components(motion.controls)
        running = np.asarray(form.running_cost(motion.times, x, u)) * motion.rate
        final = np.asarray(form.final_cost(motion.times[:, -1], x[:, :, -1]))
        return np.asarray(final + np.sum(running * self._weights, axis=-1))

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled J and the violations of equalities and margins."""
        with np.errstate(all='ignore'):
            values = self._values(xi[None])[0]
        count = self._equality_count
        violations = np.array(
            [
                np.abs(values[1 : 1 + count]).max(initial=0.0),
                (-values[1 + count :]).max(initial=0.0),
            ]
        )
        if not np.isfinite(values).all():
            return Point(xi, np.inf, np.full(2, np.inf), values)
        return Point(xi, float(values[0]), violations, values)

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Jacobian of all rows, exact Hessian of the Lagrangian made positive definite."""
        values = point.cache
        with np.errstate(all='ignore'):
            jacobian = jacobians(self._values, point.xi[None], self.scheme)[0]
            hessian = self._hessian(point.xi, jacobian, multipliers)
        count = self._equality_count
        margins, slopes = values[1 + count :], jacobian[1 + count :]
        near = np.flatnonzero((margins < _NEAR) & np.isfinite(slopes).all(axis=1))
        return Linearisation(
            gradient=jacobian[0],
            hessian=hessian,
            equalities=values[1 : 1 + count],
            equality_jacobian=jacobian[1 : 1 + count],
            inequalities=margins[near],
            inequality_jacobian=slopes[near],
            inequality_groups=np.ones(near.size, dtype=np.intp),
            tags=near,
        )

    def correction_rows(self, point: Point, at: Linearisation, active: Any) -> Array | None:
        """Residuals of the equalities and of the margins that were active."""
        count = self._equality_count
        margins = point.cache[1 + count :][at.tags[active]]
        return np.concatenate([point.cache[1 : 1 + count], np.minimum(margins, 0.0)])

    def _hessian(self, xi: Array, jacobian: Array, multipliers: Multipliers | None) -> Array:
        weights = np.zeros(len(jacobian))
        weights[0] = 1.0
        if multipliers is not None:
            count = self._equality_count
            weights[1 : 1 + count] = multipliers.equalities
            weights[1 + count + multipliers.tags] = -multipliers.inequalities

        def lagrangian(points: Any) -> Any:
            return self._values(points)[:, used] @ weights[used, None]

        used = weights != 0
        step = _HESSIAN_STEP if self.scheme == 'complex_step' else 100 * _HESSIAN_STEP
        gradients = jacobians(lagrangian, xi + step * np.eye(xi.size), self.scheme)[:, 0]
        hessian = (gradients - weights[used] @ jacobian[used]) / step
        hessian = np.nan_to_num(0.5 * (hessian + hessian.T), posinf=0.0, neginf=0.0)
        eigenvalues, vectors = np.linalg.eigh(hessian)
        least = max(_LEAST_CURVATURE, 1e-6 * float(np.abs(eigenvalues).max(initial=0.0)))
        return np.asarray((vectors * np.maximum(eigenvalues, least)) @ vectors.T)

    def _values(self, xi: Values) -> Values:
        """Scaled J, equalities, margins of candidates (B, n): (B, 1 + ne + ni)."""
        self.evaluations += len(xi)
        motion = self.motion(xi)
        form, x, u = self.formulation, components(motion.states), components(motion.controls)
        equalities = [
            (motion.states[:, -1, form.state_names.index(name)] - state.end) / state.scale
            for name, state in self.integrated.items()
            if state.end is not None
        ]
        end = form.end_conditions(motion.times[:, -1], x[:, :, -1])
        equalities += [np.broadcast_to(value, len(xi)) for value in end]
        self._equality_count = len(equalities)
        margins = []
        for name, value in form.margins(motion.times, x, u).items():
            margin = np.array(np.broadcast_to(value, motion.times.shape))
            margin[:, 1:-1] -= self.reserve.get(name, 0.0)
            margins.append(margin)
        head = [(self.cost(motion) / self.cost_scale)[:, None]]
        return np.concatenate([*head, *(value[:, None] for value in equalities), *margins], axis=1)

    def _timing(self, xi: Values, s: Array) -> tuple[list[Values], Values]:
        """Return mu and its derivatives by s, and t, at s (P,): (B, P) each."""
        coefficients = self._coefficients(xi)
        highest = max(len(tabulated.given) for tabulated in self._outputs.values())
        rates = [
            coefficients @ bernstein_basis(self._degree, s, order).T for order in range(highest)
        ]
        return rates, coefficients @ bernstein_integral(self._degree, s).T

    def _coefficients(self, xi: Values) -> Values:
        guess = self._duration.guess
        if self._duration.fixed:
            return np.full((len(xi), 1), guess)
        return np.asarray(guess * xi[:, : self._slices[1]])

    def _output_values(self, xi: Values, mu: list[Values]) -> dict[str, list[Values]]:
        """Derivatives by time of all outputs at the points of the arc, (B, P) each."""
        ends, _ = self._timing(xi, np.array([0.0, 1.0]))
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
            if self._degree == 0:
                values[name] = [value / mu[0] ** order for order, value in enumerate(jet)]
            else:
                values[name] = time_derivatives(jet, reciprocal(mu[: max(1, len(jet) - 1)]))
        return values

    def _boundary_values(self, output: Output, mu: list[Values], count: int) -> Values:
        """Derivatives by s at both ends from those by time, (B, mg)."""
        columns = []
        for side, where in enumerate(('start', 'end')):
            given = output.conditions(where)
            at = [rate[:, side] for rate in mu]
            if self._degree == 0:
                found = {order: value * at[0] ** order for order, value in given.items()}
            else:
                size = max(given, default=-1) + 1
                jet = [np.full(count, given.get(order, 0.0)) for order in range(size)]
                speed = reciprocal(self._rates_for(at, size))
                found = dict(enumerate(arc_derivatives(jet, speed))) if jet else {}
            columns += [np.broadcast_to(found[order], count) for order in given]
        return np.stack(columns, axis=-1) if columns else np.zeros((count, 0))

    @staticmethod
    def _rates_for(at: list[Values], size: int) -> list[Values]:
        zeros = [np.zeros_like(at[0])] * max(0, size - len(at))
        return [*at, *zeros]

    def _integrate(self, y: dict[str, list[Values]], mu: Values) -> dict[str, Values]:
        """Integrated states at the nodes, by name, (B, K) each."""
        names = self.formulation.state_names
        index = [names.index(name) for name in self.integrated]
        count = len(mu)
        current = np.tile([state.start for state in self.integrated.values()], (count, 1))
        current = current.astype(mu.dtype)
        found = [current]

        def rate(point: int, z: Values) -> Values:
            here = {name: [value[:, point] for value in jet] for name, jet in y.items()}
            x, u = self._invert(here, dict(zip(self.integrated, z.T, strict=True)))
            slopes = self.formulation.derivative(components(x), components(u))
            stacked = stack(slopes, len(names), 'what derivative returns')
            return np.asarray(stacked[..., index] * mu[:, point, None])

        for node in range(self.nodes.size - 1):
            h, point = float(self.nodes[node + 1] - self.nodes[node]), 2 * node
            k1 = rate(point, current)
            k2 = rate(point + 1, current + 0.5 * h * k1)
            k3 = rate(point + 1, current + 0.5 * h * k2)
            k4 = rate(point + 2, current + h * k3)
            current = current + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            found.append(current)
        z = np.stack(found, axis=1)
        return {name: z[..., i] for i, name in enumerate(self.integrated)}

    def _invert(self, y: dict[str, list[Values]], z: dict[str, Values]) -> tuple[Values, Values]:
        form = self.formulation
        states, controls = form.invert(y, z)
        shape = next(iter(y.values()))[0].shape
        found = []
        for values, names, what in (
            (states, form.state_names, 'states'),
            (controls, form.control_names, 'controls'),
        ):
            returned = f'what invert returns as {what}'
            stacked = stack(values, len(names), returned)
            try:
                found.append(np.broadcast_to(stacked, (*shape, len(names))))
            except ValueError:
                raise InvalidProblem(
                    f'{returned} has components of shape {stacked.shape[:-1]}, expected {shape}'
                ) from None
        return found[0], found[1]

    def _tabulate(self) -> dict[str, _Tabulated]:
        outputs = dict(self.formulation.outputs())
        if not outputs:
            raise InvalidProblem('a formulation needs at least one output')
        scales = {name: self._scale(output) for name, output in outputs.items()}
        largest = max(scales.values()) or 1.0
        tables = {}
        for name, output in outputs.items():
            basis = output_basis(name, output, self._degree)
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
            sizes += [abs(v) * self._duration.guess**k for k, v in given.items() if k > 0]
        return max(sizes)

    def _check_finite(self, motion: ArcMotion) -> None:
        form = self.formulation
        x, u = components(motion.states), components(motion.controls)
        margins = form.margins(motion.times, x, u)
        slopes = stack(form.derivative(x, u), len(form.state_names), 'what derivative returns')
        named = {f"invert gives state '{n}'": v for n, v in zip(form.state_names, x, strict=True)}
        named |= {
            f"invert gives control '{n}'": v for n, v in zip(form.control_names, u, strict=True)
        }
        named |= {
            f"derivative gives the rate of '{n}'": v
            for n, v in zip(form.state_names, components(slopes), strict=True)
        }
        named |= {f"margins gives '{name}'": value for name, value in margins.items()}
        named['running_cost gives J'] = form.running_cost(motion.times, x, u)
        named['final_cost gives J'] = form.final_cost(motion.times[:, -1:], x[:, :, -1:])
        shape = motion.times.shape
        values = {what: np.broadcast_to(value, shape)[0] for what, value in named.items()}
        first = {what: np.flatnonzero(~np.isfinite(value)) for what, value in values.items()}
        wrong = {what: int(nodes[0]) for what, nodes in first.items() if nodes.size}
        if wrong:
            # What is wrong at one node spoils the integration of all that follow.
            what = min(wrong, key=lambda key: wrong[key])
            node = wrong[what]
            raise InvalidProblem(
                f'{what} = {values[what][node]} at node {node} of {self.nodes.size} '
                f'(s = {self.nodes[node]:.3g}, t = {motion.times[0, node]:.3g} s)'
            )

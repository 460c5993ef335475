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

"""
A formulation as the nonlinear program (10) in the scaled varied parameters Xi.

Xi holds the duration (or the coefficients of the speed factor's dt/ds) in units of the first
guess, then the free parameters of every output in units of its scale. Along the arc, s in [0, 1]:

    X(s) = given(s) b(Xi) + varied(s) a,   d/dt = (1/mu) d/ds,   t(s) = integral of mu,

with b the boundary values converted exactly to derivatives by s; states and controls by
`Formulation.invert`, integrated states by the classical Runge-Kutta method from node to node,
J by Clenshaw-Curtis quadrature. Many candidates are computed at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.arc_motion import ArcMotion, check_finite, check_integrated
from tdm_planner.direct_method.arc_nodes import check_nodes, quadrature_weights
from tdm_planner.direct_method.arc_outputs import ArcOutputs
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.differentiation import choose_scheme, jacobians, Scheme
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]
Values = NDArray[Any]

_NEAR = 1.0  # margin within which a node gets a row
_HESSIAN_STEP = 1e-5
_LEAST_CURVATURE = 1e-4
_HESSIAN_BATCH = 400  # most candidates between two looks at the clock
_HESSIAN_WORK = 200_000  # most products in a batch: more make BLAS start threads


class Transcription(NonlinearProgram):
    """
    The program of a formulation on the given `nodes` (K,), from 0 to 1.

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
        self.nodes = check_nodes(nodes)
        self.reserve = dict(reserve or {})
        self.evaluations = 0
        self.cost_scale = 1.0
        self.scheme: Scheme = 'complex_step'
        self._equality_count = 0
        self._checked = False  # whether shapes have been found to be right
        self._stated = CheckedFormulation(formulation)
        self.integrated = self._stated.integrated()
        middles = 0.5 * (self.nodes[1:] + self.nodes[:-1])
        points = np.sort([*self.nodes, *middles]) if self.integrated else self.nodes
        self._stride = 2 if self.integrated else 1
        duration = self._stated.duration()
        self._arc = ArcOutputs(self._stated.outputs(), duration, points)
        shortest, longest = duration.bounds
        self.lower = np.full(self._arc.size, -1e3)
        self.upper = np.full(self._arc.size, 1e3)
        self.lower[self._arc.timing] = shortest / duration.guess
        self.upper[self._arc.timing] = longest / duration.guess

    @property
    def size(self) -> int:
        """Return the number of varied parameters."""
        return int(self.lower.size)

    @property
    def first_guess(self) -> Array:
        """Return the guessed duration, and nothing beside the boundary conditions."""
        xi = np.zeros(self.size)
        xi[self._arc.timing] = 1.0
        return xi

    @cached_property
    def _weights(self) -> Array:
        return quadrature_weights(self.nodes)

    def begin(self, xi: Array) -> None:
        """
        Scale the cost and choose the scheme of differentiation at a first point (n,).

        Raises
        ------
        InvalidProblem
            Naming function, node and value, if something is not a finite number there, differs
            from what is integrated, or depends on other candidates that are computed at once.

        """
        with np.errstate(all='ignore'):
            motion, z = self._motion(xi[None])
            check_finite(self._stated, motion, self.nodes)
            check_integrated(self._stated, motion, z, self.nodes)
            self.cost_scale = 1.0
            values = self._values(xi[None])[0]
            self._check_independent(xi, values)
            cost = abs(float(values[0]))
            self.cost_scale = cost if cost > 1e-9 else 1.0
            self._checked = True
            self.scheme = choose_scheme(self._values, xi)

    def refine(self, nodes: Array, reserve: Mapping[str, float]) -> Transcription:
        """Return the program on other nodes, scaled and differentiated alike."""
        other = Transcription(self.formulation, nodes, reserve)
        other.cost_scale, other.scheme = self.cost_scale, self.scheme
        other._checked = self._checked
        return other

    def motion(self, xi: Values) -> ArcMotion:
        """Motion of candidates (B, n) at the nodes."""
        return self._motion(xi)[0]

    def _motion(self, xi: Values) -> tuple[ArcMotion, dict[str, Values]]:
        """Return the motion, and the integrated states (B, K) by name."""
        mu, times, y = self._arc.values(xi)
        every = slice(None, None, self._stride)
        z = self._integrate(y, mu) if self.integrated else {}
        at_nodes = {name: [value[:, every] for value in jet] for name, jet in y.items()}
        states, controls = self._stated.invert(at_nodes, z)
        return ArcMotion(times[:, every], states, controls, mu[:, every]), z

    @property
    def has_end_conditions(self) -> bool:
        """Whether conditions remain at the end that no reference function meets by itself."""
        return self._equality_count > 0

    def misses(self, xi: Array) -> Array:
        """Return by how much candidates (B, n) miss the conditions at the end, summed up: (B,)."""
        with np.errstate(all='ignore'):
            values = self._values(xi)
        return np.asarray(np.abs(values[:, self._parts[0]]).sum(axis=1))

    def cost(self, motion: ArcMotion) -> Values:
        """Return J of the candidates, (B,)."""
        running = self._stated.running_cost(motion.times, motion.states, motion.controls)
        final = self._stated.final_cost(motion.times[:, -1], motion.states[:, -1])
        return np.asarray(final + np.sum(running * motion.rate * self._weights, axis=-1))

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled J and the violations of equalities and margins."""
        with np.errstate(all='ignore'):
            values = self._values(xi[None])[0]
        ends, margins = self._parts
        violations = np.array(
            [np.abs(values[ends]).max(initial=0.0), (-values[margins]).max(initial=0.0)]
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
        ends, rest = self._parts
        margins, slopes = values[rest], jacobian[rest]
        near = np.flatnonzero((margins < _NEAR) & np.isfinite(slopes).all(axis=1))
        return Linearisation(
            gradient=jacobian[0],
            hessian=hessian,
            equalities=values[ends],
            equality_jacobian=jacobian[ends],
            inequalities=margins[near],
            inequality_jacobian=slopes[near],
            inequality_groups=np.ones(near.size, dtype=np.intp),
            tags=near,
        )

    def correction_rows(self, point: Point, at: Linearisation, active: Any) -> Array | None:
        """Residuals of the equalities and of the margins that were active."""
        ends, rest = self._parts
        margins = point.cache[rest][at.tags[active]]
        return np.concatenate([point.cache[ends], np.minimum(margins, 0.0)])

    @property
    def _parts(self) -> tuple[slice, slice]:
        """Where equalities and margins stand among all values, which begin with J."""
        first = 1 + self._equality_count
        return slice(1, first), slice(first, None)

    @property
    def _hessian_rows(self) -> int:
        """How many rows to compute at once; integration has a price for every batch."""
        batch = _HESSIAN_BATCH
        if not self.integrated:
            batch = min(batch, _HESSIAN_WORK // (self.size * self.nodes.size))
        return max(1, batch // self.size)

    def _hessian(self, xi: Array, jacobian: Array, multipliers: Multipliers | None) -> Array:
        weights = np.zeros(len(jacobian))
        weights[0] = 1.0
        if multipliers is not None:
            ends, rest = self._parts
            weights[ends] = multipliers.equalities
            weights[rest.start + multipliers.tags] = -multipliers.inequalities
        used = weights != 0

        def lagrangian(points: Any) -> Any:
            return self._values(points)[:, used] @ weights[used, None]

        step = _HESSIAN_STEP if self.scheme == 'complex_step' else 100 * _HESSIAN_STEP
        rows = self._hessian_rows
        gradients = np.zeros((xi.size, xi.size))
        moved = xi + step * np.eye(xi.size)
        for first in range(0, xi.size, rows):
            if self.budget is not None and self.budget.spent:
                return np.eye(xi.size)  # the search ends here and has no use for it
            batch = slice(first, first + rows)
            gradients[batch] = jacobians(lagrangian, moved[batch], self.scheme)[:, 0]
        hessian = (gradients - weights[used] @ jacobian[used]) / step
        hessian = np.nan_to_num(0.5 * (hessian + hessian.T), posinf=0.0, neginf=0.0)
        eigenvalues, vectors = np.linalg.eigh(hessian)
        least = max(_LEAST_CURVATURE, 1e-6 * float(np.abs(eigenvalues).max(initial=0.0)))
        return np.asarray((vectors * np.maximum(eigenvalues, least)) @ vectors.T)

    def _values(self, xi: Values) -> Values:
        """Scaled J, equalities, margins of candidates (B, n): (B, 1 + ne + ni)."""
        self.evaluations += len(xi)
        motion = self.motion(xi)
        times, states, controls = motion.times, motion.states, motion.controls
        equalities = [
            (states[:, -1, self._stated.state_names.index(name)] - state.end) / state.scale
            for name, state in self.integrated.items()
            if state.end is not None
        ]
        equalities += self._stated.end_conditions(times[:, -1], states[:, -1])
        self._equality_count = len(equalities)
        margins = []
        for name, value in self._stated.margins(times, states, controls).items():
            margin = np.array(value)
            margin[:, 1:-1] -= self.reserve.get(name, 0.0)
            margins.append(margin)
        head = [(self.cost(motion) / self.cost_scale)[:, None]]
        return np.concatenate([*head, *(value[:, None] for value in equalities), *margins], axis=1)

    def _integrate(self, y: dict[str, list[Values]], mu: Values) -> dict[str, Values]:
        """Integrated states at the nodes, by name, (B, K) each."""
        index = [self._stated.state_names.index(name) for name in self.integrated]
        count = len(mu)
        current = np.tile([state.start for state in self.integrated.values()], (count, 1))
        kinds = [value.dtype for jet in y.values() for value in jet]
        current = current.astype(np.result_type(mu, *kinds))
        found = [current]

        def rate(point: int, z: Values) -> Values:
            here = {name: [value[:, point] for value in jet] for name, jet in y.items()}
            named = dict(zip(self.integrated, z.T, strict=True))
            if self._checked:
                slopes = self._stated.slopes(here, named, index)
            else:
                slopes = self._stated.derivative(*self._stated.invert(here, named))[..., index]
            return np.asarray(slopes * mu[:, point, None])

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

    def _check_independent(self, xi: Array, alone: Array) -> None:
        """Check that a candidate has the same values in company as alone."""
        together = self._values(np.stack([xi, 1.01 * xi + 0.01]))[0]
        same = np.isclose(together, alone, rtol=1e-6, atol=1e-9, equal_nan=True)
        if not same.all():
            raise InvalidProblem(
                f'{self._row_name(int(np.argmin(same)))} differs when two candidates are computed '
                'at once: write it with functions that act on every node alone, without sums, '
                'extrema or loops over nodes'
            )

    def _row_name(self, row: int) -> str:
        """Return where the row of `_values` comes from."""
        if row == 0:
            return 'J by running_cost or final_cost'
        if row <= self._equality_count:
            return f'end condition {row - 1}'
        names = self._stated.margin_names
        return f"margins '{names[(row - 1 - self._equality_count) // self.nodes.size]}'"

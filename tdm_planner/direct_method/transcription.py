# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A formulation as the nonlinear program (10) in the scaled varied parameters Xi.

Xi holds the duration (or the coefficients of the speed factor's dt/ds) in units of the first
guess, then the free parameters of every output in units of its scale. Along the arc, s in [0, 1]:

    X(s) = given(s) b(Xi) + varied(s) a,   d/dt = (1/mu) d/ds,   t(s) = integral of mu,

with b the boundary values converted exactly to derivatives by s; states and controls by
`Formulation.invert`, integrated states by the classical Runge-Kutta method from node to node,
J by Clenshaw-Curtis quadrature. What is stated is traced at one node; all else is constant
matrices, so that first and second derivatives are exact and cheap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
import math

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.arc_basis import (
    ArcBasis,
    ArcMotion,
    check_finite,
    check_integrated,
    NodeGraphs,
)
from tdm_planner.direct_method.bases import quadrature_weights
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.tracing import Trace

_NEAR = 1.0  # margin within which a node gets a row
_CHANGES, _CHANGE = 8, 0.1  # of the first point, that tell how J varies; their size
_UNUSUAL = 100.0  # times that, or a share: such a J has a constant part
_LEAST_CURVATURE = 1e-4


class Transcription(NonlinearProgram):
    """
    The program of a formulation on the given `nodes` (K,), from 0 to 1.

    `reserve` is what must be left to a limit, by name, at the nodes between the ends, beyond what
    the formulation reserves. Group 0 of the constraints are equalities (ends of integrated states,
    conditions at both ends), group 1 margins. `trace` is that of the formulation, if known;
    `kept_at_ends` (2, nm) what must be left to every limit there.

    Boundary conditions that contradict each other, components that do not match the names, and
    what cannot be traced raise InvalidProblem.
    """

    def __init__(
        self,
        formulation: Formulation,
        nodes: Array,
        reserve: Mapping[str, float] | None = None,
        trace: Trace | None = None,
        kept_at_ends: Array | None = None,
    ) -> None:
        self.formulation = formulation
        self.nodes = nodes
        self.cost_scale, self._constant = 1.0, 0.0
        self._stated = CheckedFormulation(formulation)
        self.integrated = self._stated.integrated()
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        points = np.sort([*nodes, *middles]) if self.integrated else nodes
        self._stride = 2 if self.integrated else 1
        duration = self._stated.duration()
        self.basis = ArcBasis(self._stated.outputs(), duration, points)
        self.trace = trace or Trace.of(self._stated)
        self._numbers = self.trace.values(formulation)
        self._graphs = NodeGraphs.of(self.trace, self.basis.layout, self._stated)
        self._calls: dict[tuple[str, str, int | None], Call] = {}
        shortest, longest = duration.bounds
        self.upper = np.full(self.basis.size, 1e3)
        self.lower = -self.upper
        self.lower[: self.basis.timing] = shortest / duration.guess
        self.upper[: self.basis.timing] = longest / duration.guess
        self.size = self.basis.size
        # Integrated states with a given end: index among them, end, scale.
        states = enumerate(self.integrated.values())
        self._ended = [(i, s.end, s.scale) for i, s in states if s.end is not None]
        steps = np.diff(nodes)
        self._step_numbers = np.hstack([np.tile(self._numbers, (steps.size, 1)), steps[:, None]])
        # Where equalities and margins stand among all values, which begin with J.
        first = 1 + len(self._ended) + self._graphs.ends + self._graphs.starts
        self._parts = slice(1, first), slice(first, None)
        # Whether conditions remain at an end that no reference function meets by itself.
        self.has_end_conditions = first > 1
        # What is kept of every limit at the nodes, (K, nm).
        names, reserve, self._kept_at_ends = self.trace.margin_names, reserve or {}, kept_at_ends
        self._kept = np.tile(self._stated.reserves(names), (nodes.size, 1))
        self._kept[1:-1] += np.array([reserve.get(name, 0.0) for name in names])
        if kept_at_ends is not None:
            self._kept[[0, -1]] = kept_at_ends

    @cached_property
    def _weights(self) -> Array:
        """Weights (K,) of the cost's quadrature: not needed by those who only sample a motion."""
        return quadrature_weights(self.nodes)

    @cached_property
    def first_guess(self) -> Array:
        """Return the guessed duration, and the outputs nearest to the stated `first_guess`."""
        xi = np.zeros(self.size)
        xi[: self.basis.timing] = 1.0
        wanted = self._stated.guess(self.nodes)
        w = self.basis.values(xi)
        basis, row, first = self.basis, self.basis.layout.rates + 1, self.basis.timing
        for name, order in zip(basis.layout.names, basis.layout.orders, strict=True):
            last = first + basis.free[name]
            if name in wanted and last > first:
                shapes = basis.scales[name] * basis.bases[name].varied(self.nodes, 0)
                missing = wanted[name] - w[:: self._stride, row]
                xi[first:last] = np.linalg.lstsq(shapes, missing, rcond=None)[0]
            row, first = row + order + 1, last
        return xi

    def begin(self, xi: Array) -> None:
        """
        Scale the cost at a first point (n,).

        Raise InvalidProblem, naming function, node and value, if something is not a finite number
        there, or differs from what is integrated.
        """
        with np.errstate(all='ignore'):
            motion, z = self._motion(xi)
            check_finite(self._stated, motion, self.nodes)
            check_integrated(self._stated, motion, z, self.nodes)
        self.cost_scale, self._constant = 1.0, 0.0
        cost = self.evaluate(xi).cost
        changes = _CHANGE * np.random.default_rng(0).choice([-1.0, 1.0], (_CHANGES, xi.size))
        costs = [self.evaluate(xi + change).cost for change in changes]
        varies = max((abs(c - cost) for c in costs if math.isfinite(c)), default=0.0) / _CHANGE
        # A plan depends neither on the unit of J nor on a constant in it.
        usual = varies / _UNUSUAL <= abs(cost) < _UNUSUAL * varies
        scale = abs(cost) if usual or varies == 0.0 else varies
        if scale > 0.0:
            self.cost_scale, self._constant = scale, cost - math.copysign(scale, cost)

    def cost(self, point: Point) -> float:
        """Return J of a point."""
        return self._constant + self.cost_scale * point.cost

    def refine(self, nodes: Array, reserve: Mapping[str, float]) -> Transcription:
        """Return the program on other nodes, scaled alike."""
        other = Transcription(self.formulation, nodes, reserve, self.trace, self._kept_at_ends)
        other.cost_scale, other._constant = self.cost_scale, self._constant
        return other

    def motion(self, xi: Array) -> ArcMotion:
        """Motion of a candidate (n,) at the nodes."""
        return self._motion(xi)[0]

    def _motion(self, xi: Array) -> tuple[ArcMotion, Array]:
        """Return the motion, and the integrated states (K, nz)."""
        wz, _ = self._nodes(self.basis.values(xi))
        (both,) = Call(self._graphs.motion, len(wz))(wz, self._numbers)
        rates, nx = self.basis.layout.rates, len(self._stated.state_names)
        motion = ArcMotion(wz[:, rates], both[:, :nx], both[:, nx:])
        return motion, np.split(wz, [self.basis.layout.size], axis=1)[1]

    def flow(self, xi: Array) -> tuple[Array, Array]:
        """
        Return the rates of the states along a candidate, (K, nx): by `invert`, by `derivative`.

        They are the same where the two state the same motion.
        """
        outputs = {
            name: replace(output, derivatives=output.derivatives + 1)
            for name, output in self._stated.outputs().items()
        }
        basis = ArcBasis(outputs, self.basis.duration, self.nodes)
        _, _, jets = basis.layout.read(basis.values(xi).T)
        y = np.stack([value for jet in jets.values() for value in jet], axis=-1)
        _, z = self._motion(xi)
        by_inverse, rates = Call(self.trace.flow, len(z))(y, z, self._numbers)
        return by_inverse, rates

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled J and the violations of equalities and margins."""
        wz, steps = self._nodes(self.basis.values(xi))
        rows = self._call('node', 'value', len(wz))(wz, self._numbers)[0]
        start = self._call('start', 'value')(wz[0], self._numbers)[0]
        end = self._call('end', 'value')(wz[-1], self._numbers)[0]
        cost = (end[0] + self._weights @ rows[:, 0] - self._constant) / self.cost_scale
        nw = self.basis.layout.size
        missed = [(wz[-1, nw + i] - value) / scale for i, value, scale in self._ended]
        margins = (rows[:, 1:] - self._kept).T.ravel()
        values = np.concatenate([[cost], missed, end[1:], start, margins])
        ends, rest = self._parts
        cache = values, wz, steps
        if not np.isfinite(values).all():
            return Point(xi, np.inf, np.full(2, np.inf), cache)
        violations = [np.abs(values[ends]).max(initial=0.0), (-values[rest]).max(initial=0.0)]
        return Point(xi, float(cost), np.array(violations), cache, values[ends], values[rest])

    def violated(self, point: Point) -> str:
        """Return what a point violates most, reserves counted, and by how much."""
        ends, rest = (point.cache[0][part] for part in self._parts)
        missed, margin = np.abs(ends), rest.min(initial=np.inf)
        if missed.max(initial=0.0) <= max(-margin, 0.0):
            name = self.trace.margin_names[int(np.argmin(rest)) // self.nodes.size]
            size, unit = self._stated.size_of(name)
            return f'{name} by {-margin * size:.2g} {unit}'.rstrip()
        row = int(np.argmax(missed))
        if row >= len(self._ended):
            where = 'end' if row < len(self._ended) + self._graphs.ends else 'start'
            return f'the conditions at the {where} by {missed[row]:.2g}'
        index, _, scale = self._ended[row]
        name = list(self.integrated)[index]
        unit = self.formulation.state_units[self._stated.state_names.index(name)]
        return f'the condition at the end on {name} by {missed[row] * scale:.2g} {unit}'.rstrip()

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Jacobian of all rows, exact Hessian of the Lagrangian made positive definite."""
        with np.errstate(all='ignore'):
            jacobian, hessian = self.derivatives(point, multipliers)
        hessian = np.nan_to_num(0.5 * (hessian + hessian.T), posinf=0.0, neginf=0.0)
        eigenvalues, vectors = np.linalg.eigh(hessian)
        least = max(_LEAST_CURVATURE, 1e-6 * float(np.abs(eigenvalues).max(initial=0.0)))
        ends, rest = self._parts
        margins, slopes = point.margins, jacobian[rest]
        near = np.flatnonzero((margins < _NEAR) & np.isfinite(slopes).all(axis=1))
        return Linearisation(
            gradient=jacobian[0],
            hessian=np.asarray((vectors * np.maximum(eigenvalues, least)) @ vectors.T),
            equalities=point.equalities,
            equality_jacobian=jacobian[ends],
            inequalities=margins[near],
            inequality_jacobian=slopes[near],
            inequality_groups=np.ones(near.size, dtype=np.intp),
            tags=near,
        )

    def derivatives(self, point: Point, multipliers: Multipliers | None) -> tuple[Array, Array]:
        """Jacobian (1 + ne + ni, n) of all rows, and Hessian (n, n) of the Lagrangian."""
        (_, wz, steps), p = point.cache, self._numbers
        nw, n, count = self.basis.layout.size, point.xi.size, len(wz)
        every = self.basis.slopes(point.xi)
        slopes = every[:: self._stride]
        chain = np.zeros((0, 0, 0))
        if self.integrated:
            nz = len(self.integrated)
            local = self._call('step', 'linear', count - 1)(steps, self._step_numbers)[1]
            local = local.reshape(count - 1, nz, -1)
            outer = np.zeros((count - 1, 3 * nw + nz, n))
            wide = 3 * nw
            outer[:, :wide] = np.concatenate([every[:-1:2], every[1::2], every[2::2]], axis=1)
            of_z, chain = np.zeros((count, nz, n)), local[:, :, wide:]
            direct = local[:, :, :wide] @ outer[:, :wide]
            for step in range(count - 1):
                of_z[step + 1] = chain[step] @ of_z[step] + direct[step]
            outer[:, wide:] = of_z[:-1]
            slopes = np.concatenate([slopes, of_z], axis=1)
        nodes = self._call('node', 'linear', count)(wz, p)[1].reshape(count, -1, wz.shape[1])
        start = self._call('start', 'linear')(wz[0], p)[1].reshape(-1, wz.shape[1])
        end = self._call('end', 'linear')(wz[-1], p)[1].reshape(-1, wz.shape[1])
        rows, ends = nodes @ slopes, end @ slopes[-1]
        scales = np.array([scale for _, _, scale in self._ended]).reshape(-1, 1)
        ended = slopes[-1, [nw + i for i, _, _ in self._ended]] / scales
        jacobian = np.concatenate(
            [
                (ends[:1] + self._weights @ rows[:, 0]) / self.cost_scale,
                ended,
                ends[1:],
                start @ slopes[0],
                rows[:, 1:].transpose(1, 0, 2).reshape(-1, n),
            ]
        )
        # The Lagrangian: its multipliers at the nodes, at both ends, and of the integrated ends.
        at_nodes, at_start, at_end, at_z = self._node_multipliers(multipliers, count)
        shape = (wz.shape[1], wz.shape[1])
        second = self._call('node', 'second', count)(wz, p, at_nodes)[0].reshape(-1, *shape)
        second[0] += self._call('start', 'second')(wz[0], p, at_start)[0].reshape(shape)
        second[-1] += self._call('end', 'second')(wz[-1], p, at_end)[0].reshape(shape)
        gradient = np.einsum('km,kmw->kw', at_nodes, nodes)
        gradient[0] += at_start @ start
        gradient[-1] += at_end @ end
        hessian = slopes.reshape(-1, n).T @ (second @ slopes).reshape(-1, n)
        by_w = np.zeros((len(every), nw))
        by_w[:: self._stride] = gradient[:, :nw]
        if self.integrated:
            adjoint = np.empty((count - 1, nz))
            adjoint[-1] = gradient[-1, nw:] + at_z
            for step in range(count - 2, 0, -1):
                adjoint[step - 1] = adjoint[step] @ chain[step] + gradient[step, nw:]
            curved = self._call('step', 'second', count - 1)(steps, self._step_numbers, adjoint)[0]
            curved = curved.reshape(count - 1, outer.shape[1], -1)
            hessian += outer.reshape(-1, n).T @ (curved @ outer).reshape(-1, n)
            through = np.einsum('kz,kzw->kw', adjoint, local)
            begin, middle, end_, _ = np.split(through, [nw, 2 * nw, wide], axis=1)
            by_w[:-1:2] += begin
            by_w[1::2] += middle
            by_w[2::2] += end_
        if not self.basis.is_linear:
            nc = self.basis.nc
            hessian[:nc, :nc] += self.basis.curvature(point.xi, by_w)
        return jacobian, hessian

    def _node_multipliers(
        self, multipliers: Multipliers | None, count: int
    ) -> tuple[Array, Array, Array, Array]:
        """Multipliers of the node's rows (K, 1 + nm), of those at both ends, and of z's end."""
        graphs, ended = self._graphs, self._ended
        limits = len(self.trace.margin_names)
        nodes = np.zeros((count, 1 + limits))
        start, end = np.zeros(graphs.starts), np.zeros(1 + graphs.ends)
        at_z = np.zeros(len(self.integrated))
        nodes[:, 0], end[0] = self._weights / self.cost_scale, 1.0 / self.cost_scale
        if multipliers is not None:
            parts = np.cumsum([len(ended), graphs.ends])
            of_z, end[1:], start[:] = np.split(multipliers.equalities, parts)
            for (index, _, scale), multiplier in zip(ended, of_z, strict=True):
                at_z[index] = multiplier / scale
            every = np.zeros(limits * count)
            every[multipliers.tags] = -multipliers.inequalities
            nodes[:, 1:] = every.reshape(limits, count).T
        return nodes, start, end, at_z

    def _nodes(self, w: Array) -> tuple[Array, Array | None]:
        """Return w and z at the nodes (K, nw + nz), and the arguments of the steps between."""
        at_nodes = w[:: self._stride]
        if not self.integrated:
            return at_nodes, None
        nw, count = w.shape[1], len(at_nodes)
        steps = np.empty((count - 1, 3 * nw + len(self.integrated)))
        wide = 3 * nw
        steps[:, :wide] = np.hstack([w[:-1:2], w[1::2], w[2::2]])
        z = np.empty((count, len(self.integrated)))
        z[0] = [state.start for state in self.integrated.values()]
        step = self._call('step', 'value')
        for node in range(count - 1):
            steps[node, wide:] = z[node]
            z[node + 1] = step(steps[node], self._step_numbers[node])[0]
        return np.hstack([at_nodes, z]), steps

    def _call(self, graph: str, which: str, count: int | None = None) -> Call:
        key = graph, which, count
        if key not in self._calls:
            self._calls[key] = Call(getattr(getattr(self._graphs, graph), which), count)
        return self._calls[key]

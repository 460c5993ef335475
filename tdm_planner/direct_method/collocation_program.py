# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The program of direct collocation, made of pieces that repeat.

A piece is an interval, by Hermite and Simpson in separated form, or the two ends. Its cost, its
rows and their exact derivatives are traced once a kind of problem; those of the program are put
together by index, so that a program on any number of intervals is made in milliseconds. See Betts,
*Practical Methods for Optimal Control Using Nonlinear Programming*, chapter 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from tdm_planner.arrays import Array, Integers, Mask
from tdm_planner.direct_method.graphs import Rounded, SimpleBounds
from tdm_planner.direct_method.tracing import Trace

_COST = 10.0  # what the size of J is scaled to along the guess
_CONSTANT = 1e-9  # share of J below which nothing is known of how it varies
_LEAST_SIZE = 1e-2  # of how J varies: it may be 0 by chance
_INNER = 0.25, 0.75  # where limits on states are kept beside an interval's ends and middle


class _Piece:
    """
    A cost f and rows g (m,) of variables x, (k,), and their derivatives.

    c are the numbers of a repetition, p those of the program: all are symbols. `jacobian` and
    `hessian` are the rows and columns of the entries that `slopes` and `curvature` give, (2, e).
    """

    def __init__(self, x: Any, c: Any, p: Any, f: Any, g: Any) -> None:
        f, g = ca.densify(f), ca.densify(g)
        of_cost, of_rows = ca.SX.sym('lf'), ca.SX.sym('lg', g.numel())
        slopes: Any = ca.jacobian(g, x)
        curvature: Any = ca.triu(ca.hessian(of_cost * f + ca.dot(of_rows, g), x)[0])
        self.jacobian, self.hessian = (
            np.array(matrix.sparsity().get_triplet(), dtype=np.intp)
            for matrix in (slopes, curvature)
        )
        entries, curved = (ca.vertcat(*matrix.nonzeros()) for matrix in (slopes, curvature))
        given = [x, c, p]
        self.size = g.numel()
        self.cost = ca.Function('cost', given, [f])
        self.rows = ca.Function('rows', given, [g])
        self.gradient = ca.Function('gradient', given, [ca.densify(ca.gradient(f, x))])
        self.slopes = ca.Function('slopes', given, [entries])
        self.curvature = ca.Function('curvature', [*given, of_cost, of_rows], [curved])


class _Pieces:
    """
    An interval, and the ends, of a traced statement: `sizes` are nx and nu.

    Scaled variables of the `interval` are the states at its begin, middle and end, the controls at
    begin and end, and the duration; of the `ends` the states at both, the last controls, and the
    duration. An interval's numbers are the share of the duration at its begin, and 1 / n.

    Limits that are `inner` are kept between nodes, too.
    """

    def __init__(self, trace: Trace) -> None:
        nx, nu = self.sizes = trace.rates.size1_in(0), trace.rates.size1_in(1)
        sizes = trace.rates.size1_in(2), nx, nu, trace.unfolded.limit.size, 1, 1, 1
        p, sx, su, sl, st, charged, unit_j = (ca.SX.sym('s', size) for size in sizes)
        parts = trace.running, trace.rates, trace.unfolded.rows
        running, motion, stated = self.rounded = [Rounded(part) for part in parts]
        e_running, e_motion, e_limits = (ca.SX.sym('e', one.count) for one in self.rounded)
        given = ca.vertcat(p, sx, su, sl, e_running, e_motion, e_limits, st, charged, unit_j)
        self.parameters = given.numel()
        self.inner = np.flatnonzero(trace.kept_between[trace.unfolded.limit])
        self.simple = SimpleBounds(trace.unfolded.rows)

        def kept(t: Any, x: Any, u: Any) -> Any:
            return stated.value(t, x, u, p, e_limits) / sl

        def kept_inside(t: Any, x: Any, u: Any) -> Any:
            rows = kept(t, x, u)
            return ca.vertcat(ca.SX(0, 1), *(rows[int(row)] for row in self.inner))

        a_, m_, b_ = (ca.SX.sym(name, nx) for name in 'amb')
        ua_, ub_ = (ca.SX.sym(name, nu) for name in 'uv')
        t_, c = ca.SX.sym('t'), ca.SX.sym('c', 2)
        a, m, b, ua, ub, duration = a_ * sx, m_ * sx, b_ * sx, ua_ * su, ub_ * su, t_ * st
        h, middle_u = duration * c[1], 0.5 * (ua + ub)
        begin, middle, end = (duration * (c[0] + share * c[1]) for share in (0.0, 0.5, 1.0))
        nodes = (begin, a, ua), (middle, m, middle_u), (end, b, ub)
        fa, fm, fb = (motion.value(x, u, p, e_motion) for _, x, u in nodes)
        rows = [
            (b - a - h / 6 * (fa + 4 * fm + fb)) / sx,
            (m - 0.5 * (a + b) - h / 8 * (fa - fb)) / sx,
            kept(*nodes[0]),
            kept_inside(*nodes[1]),
        ]
        for share in _INNER:
            w0, w1 = (1 - share) ** 2 * (1 + 2 * share), share * (1 - share) ** 2
            w2, w3 = share**2 * (3 - 2 * share), share**2 * (share - 1)
            state = a * w0 + b * w2 + h * (w1 * fa + w3 * fb)
            control = (1 - share) * ua + share * ub
            rows.append(kept_inside(duration * (c[0] + share * c[1]), state, control))
        q = [running.value(*node, p, e_running) for node in nodes]
        mean = h / 6 * (q[0] + 4 * q[1] + q[2])
        cost = _COST * (mean / unit_j + charged * ca.sumsqr(ub_ - ua_))
        variables = ca.vertcat(a_, m_, b_, ua_, ub_, t_)
        self.interval = _Piece(variables, c, given, cost, ca.vertcat(*rows))
        conditions = trace.start_conditions(0.0, a, p), trace.end_conditions(duration, b, p)
        self.conditions = sum(part.numel() for part in conditions)
        rows = [*conditions, kept(duration, b, ub)]
        cost = _COST * trace.final(duration, b, p) / unit_j
        variables = ca.vertcat(a_, b_, ub_, t_)
        self.ends = _Piece(variables, ca.SX(0, 1), given, cost, ca.vertcat(*rows))


class _Repeated(NamedTuple):
    """A piece, the indices of its `variables` (count, k), and its `numbers` (count, nc)."""

    piece: _Piece
    variables: Integers
    numbers: Array

    def all_of(self, function: Any, z: Any, p: Any, *weights: Any) -> Any:
        """Return what a function of the piece gives for every repetition, one after the other."""
        count, shared = len(self.variables), [2, 3] if weights else [2]  # arguments
        x = ca.reshape(z[self.variables.ravel().tolist()], -1, count)
        mapped = function.map(function.name(), 'serial', count, shared, [])
        return ca.vec(mapped(x, ca.DM(self.numbers.T), p, *weights))


class CollocationProgram:
    """
    The program on n intervals: `nlp` and its exact `derivatives`, as `casadi.nlpsol` takes them.

    `pieces` are what it is made of, once a kind. Its variables are states (n + 1, nx), middles
    (n, nx), controls (n + 1, nu) and the duration, all scaled; its rows are those of the intervals
    in turn, and of the ends.
    """

    def __init__(self, trace: Trace, intervals: int) -> None:
        pieces = self.pieces = trace.once(_Pieces, lambda: _Pieces(trace))
        n, (nx, nu) = intervals, pieces.sizes
        self._shapes = (n + 1, nx), (n, nx), (n + 1, nu), (1, 1)
        self._size = sum(rows * columns for rows, columns in self._shapes)
        x, m, u, t = self.split(np.arange(self._size))
        along = np.hstack([x[:-1], m, x[1:], u[:-1], u[1:], np.repeat(t, n, axis=0)])
        shares = np.stack([np.arange(n) / n, np.full(n, 1.0 / n)], axis=-1)
        every = _Repeated(pieces.interval, along, shares)
        at_ends = np.hstack([x[:1], x[-1:], u[-1:], t])
        self._assemble([every, _Repeated(pieces.ends, at_ends, np.zeros((1, 0)))])

    def _assemble(self, parts: Sequence[_Repeated]) -> None:
        """Put program and derivatives together."""
        z, p = ca.MX.sym('z', self._size), ca.MX.sym('p', self.pieces.parameters)
        first = [0, *accumulate(len(part.variables) * part.piece.size for part in parts)]
        of_cost, of_rows = ca.MX.sym('lf'), ca.MX.sym('lg', first[-1])
        cost, rows = ca.MX(0.0), []
        gradient, hessian = _Entries(self._size, 1), _Entries(self._size, self._size)
        jacobian = _Entries(first[-1], self._size)
        for part, begin, end in zip(parts, first, first[1:], strict=False):
            piece, at, count = part.piece, part.variables, len(part.variables)
            weights = of_cost, ca.reshape(of_rows[begin:end], -1, count)
            cost += ca.sum1(part.all_of(piece.cost, z, p))
            rows.append(part.all_of(piece.rows, z, p))
            gradient.add(part.all_of(piece.gradient, z, p), at, np.zeros_like(at))
            row, column = piece.jacobian
            own = begin + piece.size * np.arange(count)[:, None]
            jacobian.add(part.all_of(piece.slopes, z, p), own + row, at[:, column])
            both = np.sort(at[:, piece.hessian], axis=1)  # the upper triangle of the program's
            hessian.add(part.all_of(piece.curvature, z, p, *weights), both[:, 0], both[:, 1])
        # A row that is zero in every piece would have no place.
        self.nlp = {'x': z, 'p': p, 'f': cost, 'g': ca.densify(ca.vertcat(*rows))}
        # nlpsol's own functions give the values, too; they are not asked for them there.
        none, given = ca.MX(1, 1), [z, p]
        self.derivatives = {
            'grad_f': ca.Function('grad_f', given, [none, ca.densify(gradient.matrix())]),
            'jac_g': ca.Function('jac_g', given, [none, jacobian.matrix()]),
            'hess_lag': ca.Function('hess_lag', [*given, of_cost, of_rows], [hessian.matrix()]),
        }

    def split(self, z: Any) -> list[Any]:
        """Return states, middles, controls and duration, (1, 1), of the variables."""
        each = np.split(z, list(accumulate(rows * columns for rows, columns in self._shapes))[:-1])
        return [part.reshape(shape) for part, shape in zip(each, self._shapes, strict=True)]

    def size_of_cost(self, cost: float, z: Array, p: Array, free: Mask) -> float:
        """
        Return the size of J without its constant part.

        That is |J|, but at most what J varies by to first order if each of the variables that are
        `free` runs through its range: states as along the motion, controls and duration from zero
        on. It is also a hundredth of that at least.
        """
        x, m, u, t = self.split(z)
        spans = np.ptp(np.vstack([x, m]), axis=0), np.abs(u).max(axis=0)
        ranges = [np.broadcast_to(spans[k], v.shape) for k, v in ((0, x), (0, m), (1, u))]
        every = np.concatenate([part.ravel() for part in (*ranges, t)])
        p = np.append(p[:-2], [0.0, 1.0])  # J itself
        slopes = np.array(self.derivatives['grad_f'](z, p)[1]).ravel() / _COST
        varies = float((np.abs(slopes) * every)[free].sum())
        known = _CONSTANT * abs(cost) < varies < np.inf
        return min(max(abs(cost), _LEAST_SIZE * varies), varies) if known else abs(cost)

    def rows(self, kept: Array) -> tuple[Array, Array]:
        """
        Return lower and upper bounds of the rows, with what is `kept` (n + 1, m), scaled.

        Rows of limits that bound a single variable have none where that is one of the program's.
        """
        n, pieces = len(kept) - 1, self.pieces
        at_nodes = np.where(pieces.simple.bound, -np.inf, kept)
        parts = at_nodes, *(kept for _ in _INNER)
        within = [
            (1.0 - share) * part[:-1, pieces.inner] + share * part[1:, pieces.inner]
            for share, part in zip((0.5, *_INNER), parts, strict=True)
        ]
        least, last = np.hstack([at_nodes[:-1], *within]), at_nodes[-1]
        defects, conditions = np.zeros((n, 2 * pieces.sizes[0])), np.zeros(pieces.conditions)
        lower = np.hstack([defects, least]).ravel(), conditions, last
        most = np.hstack([defects, np.full(least.shape, np.inf)]).ravel()
        upper = most, conditions, np.full(last.shape, np.inf)
        return np.concatenate(lower), np.concatenate(upper)


class _Entries:
    """Entries of a sparse matrix; those at one place are added."""

    def __init__(self, rows: int, columns: int) -> None:
        self._shape = rows, columns
        self._values: list[Any] = []
        self._places: list[Integers] = []

    def add(self, values: Any, rows: Integers, columns: Integers) -> None:
        """Add entries in the order of `rows` and `columns` (count, e)."""
        self._values.append(values)
        self._places.append((columns * self._shape[0] + rows).ravel())

    def matrix(self) -> Any:
        """Return the matrix."""
        places, which = np.unique(np.concatenate(self._places), return_inverse=True)
        column, row = np.divmod(places, self._shape[0])
        pattern = ca.Sparsity.triplet(*self._shape, row.tolist(), column.tolist())
        order = list(range(which.size))
        added = ca.Sparsity.triplet(places.size, which.size, which.tolist(), order)
        return ca.MX(pattern, ca.mtimes(ca.DM(added, 1.0), ca.vertcat(*self._values)))

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""CasADi's functions as the engine calls them: on numpy arrays, with exact derivatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.direct_method.nonlinear_program import Budget

_PLACES, _CURVED = 5, 1e-9  # at which a limit's curvature is looked at; share that counts
_LINEAR = {ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_TWICE, ca.OP_INV}
_HOPELESS, _CHECK_PERIOD = 1e8, 5  # multipliers by J; iterations of Ipopt between checks of them
_MOST_ROWS = 16  # of one limit without kinks, whose number each kink may double

ca.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols give symbols


class Call:
    """A CasADi function on numpy arrays without copies, for `count` nodes at once if given."""

    def __init__(self, function: Any, count: int | None = None) -> None:
        mapped = function if count is None else _mapped(function, count)
        self._buffer, self._run = mapped.buffer()

        def flat(size: tuple[int, int]) -> tuple[int, ...]:
            return (size[0] * size[1],) if count is None else (size[1], size[0])

        self.given = [np.zeros(flat(mapped.size_in(i))) for i in range(mapped.n_in())]
        self._found = [np.zeros(flat(mapped.size_out(i))) for i in range(mapped.n_out())]
        for arrays, attach in (
            (self.given, self._buffer.set_arg),
            (self._found, self._buffer.set_res),
        ):
            for index, values in enumerate(arrays):
                buffer: Any = values
                if values.size:
                    attach(index, memoryview(buffer))

    def __call__(self, *arguments: Any) -> list[Array]:
        """Return the values, (m,) each, or (count, m); they are overwritten by the next call."""
        for values, argument in zip(self.given, arguments, strict=True):
            values[...] = argument
        return self.run()

    def run(self) -> list[Array]:
        """Return the values for what stands in `given`, one array an argument."""
        self._run()
        return self._found


@lru_cache(maxsize=32)
def _mapped(function: Any, count: int) -> Any:
    return function.map(count)


class Differentiated:
    """A vector f(x; p), its Jacobian, and the Hessian of l'f: dense CasADi functions."""

    def __init__(self, name: str, x: Any, p: Any, f: Any) -> None:
        multipliers = ca.SX.sym('l', f.numel())
        jacobian = ca.densify(ca.jacobian(f, x))
        hessian = ca.densify(ca.hessian(ca.dot(multipliers, f), x)[0])
        f = ca.densify(f)
        self.value = ca.Function(name, [x, p], [f])
        # Rows contiguous in memory.
        self.linear = ca.Function(f'{name}_j', [x, p], [f, jacobian.T.reshape((-1, 1))])
        self.second = ca.Function(f'{name}_h', [x, p, multipliers], [hessian.reshape((-1, 1))])


class Rounded:
    """
    A traced function f(..., p), such as |u|, with rounded kinks: Ipopt needs second derivatives.

    The graph is written again with sqrt(a^2 + e^2) in place of |a|, likewise where a maximum,
    minimum, square root or hypotenuse has its kink.
    `value` (..., p, e) -> f, with e (k,) how far each kink is rounded; `sizes` (..., p) -> (k,)
    what stands in every kink, to choose e by; `count` is k; `either` (k,) tells which are maxima
    or minima.
    """

    def __init__(self, function: Any) -> None:
        radius: list[Any] = []
        inside: list[Any] = []
        either: list[bool] = []

        def root(square: Any, size: Any, of_two: bool = False) -> Any:
            radius.append(ca.SX.sym('e'))
            inside.append(size)
            either.append(of_two)
            return ca.sqrt(square + radius[-1] ** 2)

        def rounded(operation: int, a: Any, b: Any) -> Any:
            if operation == ca.OP_FABS:
                return root(a**2, a)
            if operation == ca.OP_SQRT:
                return root(a, ca.sqrt(a))
            if operation == ca.OP_HYPOT:
                return root(a**2 + b**2, ca.hypot(a, b))
            if operation in (ca.OP_FMAX, ca.OP_FMIN):
                apart = root((a - b) ** 2, a - b, of_two=True)
                return 0.5 * (a + b + (apart if operation == ca.OP_FMAX else -apart))
            return None

        given, results = _rewritten(function, rounded)
        self.count, self.either = len(radius), np.array(either, dtype=bool)
        e = ca.vertcat(ca.SX(0, 1), *radius)
        self.value = ca.Function('rounded', [*given, e], results)
        sizes = ca.substitute(ca.vertcat(ca.SX(0, 1), *inside), e, 0.0)  # of kinks in kinks, too
        self.sizes = ca.Function('kinks', given, [sizes])


def _rewritten(
    function: Any, replace: Callable[[int, Any, Any], Any]
) -> tuple[list[Any], list[Any]]:
    """
    Write the graph of a function again; return what it is given, and its results.

    `replace` gets every operation and its operands, of which a unary one has the same twice, and
    returns what is to stand for it; None leaves it.
    """
    given = function.sx_in()
    found: list[Any] = [None] * function.sz_w()
    results = [ca.SX.zeros(function.size_out(i)) for i in range(function.n_out())]
    for index in range(function.n_instructions()):
        operation = function.instruction_id(index)
        takes, gives = function.instruction_input(index), function.instruction_output(index)
        if operation == ca.OP_CONST:
            found[gives[0]] = ca.SX(function.instruction_constant(index))
        elif operation == ca.OP_INPUT:
            found[gives[0]] = given[takes[0]].nz[takes[1]]
        elif operation == ca.OP_OUTPUT:
            results[gives[0]].nz[gives[1]] = found[takes[0]]
        else:
            values = [found[place] for place in takes]
            other = replace(operation, values[0], values[-1])
            if other is None:
                alone = len(values) == 1
                other = (ca.SX.unary if alone else ca.SX.binary)(operation, *values)
            found[gives[0]] = other
    return given, results


class Unfolded:
    """
    Limits f(t, x, u, p) as `rows` without the kinks that only fold them; `limit` (m,) of each row.

    L - |a| is the lesser of L - a and L + a, which have no kink at a = 0: both must be kept, as
    the branches of a minimum, and of a maximum that is subtracted. Where the greater branch
    would do, or the slope with respect to the kink is not constant, the kink stays. Ipopt needs
    several times the iterations where it stands, and often does not converge. It was decided by
    the `numbers` p; `takes_same_branches` tells for which others it holds.
    """

    def __init__(self, margins: Any, numbers: Array) -> None:
        kinks: list[tuple[Any, Any, tuple[Any, Any], float]] = []  # symbol, whole, branches, sign

        def cut(operation: int, a: Any, b: Any) -> Any:
            if operation not in (ca.OP_FABS, ca.OP_FMAX, ca.OP_FMIN):
                return None
            alone = operation == ca.OP_FABS
            whole = ca.SX.unary(operation, a) if alone else ca.SX.binary(operation, a, b)
            sign = 1.0 if operation == ca.OP_FMIN else -1.0
            kinks.append((ca.SX.sym('k'), whole, (a, -a if alone else b), sign))
            return kinks[-1][0]

        given, (limits,) = _rewritten(margins, cut)
        varied, p = ca.vertcat(*given[:-1], *(kink[0] for kink in kinks)), given[-1]
        rows = [(row, limit) for limit, row in enumerate(ca.vertsplit(limits))]
        slopes = [ca.SX(0, 1)]  # that decided
        for symbol, whole, branches, sign in reversed(kinks):  # those that hold others come first
            counts, parts = Counter(limit for _, limit in rows), []
            for row, limit in rows:
                slope, ways = sign * ca.jacobian(row, symbol), (whole,)
                if not ca.depends_on(row, symbol):
                    parts.append((row, limit))
                    continue
                if not ca.depends_on(slope, varied):
                    slopes.append(slope)
                    lesser = float(ca.Function('slope', [p], [slope])(numbers)) > 0.0
                    ways = branches if lesser and counts[limit] < _MOST_ROWS else ways
                parts += [(ca.substitute(row, symbol, way), limit) for way in ways]
            rows = parts
        every = ca.vertcat(ca.SX(0, 1), *(row for row, _ in rows))
        self.rows = ca.Function('limits', given, [every])
        self.limit = np.array([limit for _, limit in rows], np.intp)
        self._slopes = ca.Function('slopes', [p], [ca.densify(ca.vertcat(*slopes))])
        self._signs = self._decided(numbers)

    def _decided(self, numbers: Array) -> Array:
        return np.asarray(np.sign(np.array(self._slopes(numbers)).ravel()))

    def takes_same_branches(self, numbers: Array) -> bool:
        """Whether the limits unfold in the same way for other numbers p."""
        return bool(np.array_equal(self._decided(numbers), self._signs))


class SimpleBounds:
    """
    Limits f(t, x, u, p) that are linear in one state or control alone: `bound` (m,) tells which.

    Ipopt may violate a limit on the way to a solution, but not the bounds of a variable: what is
    to be positive stays so, and rates with a pole beyond stay finite.
    """

    def __init__(self, limits: Any) -> None:
        def curved(operation: int, a: Any, b: Any) -> Any:
            """Stand for what is not linear or jumps, whose slope may be constant in between."""
            return None if operation in _LINEAR else ca.sin(a) + ca.exp(b)

        (t, x, u, p), (shapes,) = _rewritten(limits, curved)
        rows, varied = limits(t, x, u, p), ca.vertcat(x, u, t)
        slopes = ca.jacobian(rows, varied)
        row, variable = (np.array(at, np.intp) for at in slopes.sparsity().get_triplet())
        linear = ~np.array(ca.which_depends(shapes, varied, 2, True), dtype=bool)
        single = linear & (np.bincount(row, minlength=linear.size) == 1)
        chosen = single[row] & (variable < varied.numel() - 1)
        self._rows, self._variables = row[chosen], variable[chosen]
        self._count = x.numel() + u.numel()
        self.bound = np.isin(np.arange(linear.size), self._rows)
        pairs = zip(self._rows.tolist(), self._variables.tolist(), strict=True)
        found = ca.vertcat(ca.SX(0, 1), *(slopes[i, k] for i, k in pairs))
        at_zero = ca.substitute(rows, varied, 0.0)[self._rows.tolist()]
        self._line = ca.Function('line', [p], [ca.densify(found), ca.densify(at_zero)])

    def bounds(self, numbers: Array, kept: Array) -> Array:
        """Return bounds of states and controls, (2, n, nx + nu), that leave `kept` (n, m)."""
        found = np.full((self._count, len(kept), 2), [-np.inf, np.inf]).T
        slopes, at_zero = (np.array(values).ravel() for values in self._line(numbers))
        for row, k, slope, least in zip(self._rows, self._variables, slopes, at_zero, strict=True):
            if slope:
                side, tighter = (0, np.maximum) if slope > 0.0 else (1, np.minimum)
                found[side][:, k] = tighter(found[side][:, k], (kept[:, row] - least) / slope)
        return found


def breaks_of(function: Any) -> Any:
    """Return what changes its sign where a traced function has a kink or a jump, a function."""
    found: list[Any] = [ca.SX(0, 1)]

    def note(operation: int, a: Any, b: Any) -> None:
        if operation in (ca.OP_FABS, ca.OP_SIGN):
            found.append(a)
        elif operation in (ca.OP_FMAX, ca.OP_FMIN, ca.OP_LT, ca.OP_LE, ca.OP_EQ):
            found.append(a - b)

    given, _ = _rewritten(function, note)
    return ca.Function('breaks', given, [ca.densify(ca.vertcat(*found))])


class Bends:
    """
    Which limits f(t, x, u, p) may be violated between two points that keep them.

    `of` tells the argument that varies: 'x' or 'u'. Kinks count as rounded. It depends on p: an
    obstacle may be switched off.
    """

    def __init__(self, margins: Any, of: str) -> None:
        t, x, u, _ = given = margins.sx_in()
        rounded = Rounded(margins)
        rows = rounded.value(*given, np.ones(rounded.count))
        varied = {'x': x, 'u': u}[of]
        self._shape = rows.numel(), varied.numel(), varied.numel()
        hessians = [ca.vec(ca.hessian(row, varied)[0]) for row in ca.vertsplit(rows)]
        of_all = ca.densify(ca.vertcat(ca.SX(0, 1), *hessians))
        self._hessians = ca.Function('hessians', given, [of_all])
        rng = np.random.default_rng(0)
        self._places = [
            [rng.normal(size=part.numel()) for part in (t, x, u)] for _ in range(_PLACES)
        ]

    def __call__(self, numbers: Array) -> Mask:
        """Return the mask of limits (nm,) for the numbers p."""
        call = Call(self._hessians)  # of its own: traces serve several threads
        found = [call(*place, numbers)[0].copy() for place in self._places]
        matrices = np.nan_to_num(found).reshape(_PLACES, *self._shape)
        largest = np.linalg.eigvalsh(matrices)[..., -1]
        bent: Mask = (largest > _CURVED * np.abs(matrices).max(axis=(2, 3))).any(axis=0)
        return bent


class IpoptStop(ca.Callback):
    """
    Stops Ipopt when time or iterations are up, or its multipliers tell that there is no solution.

    They grow without end then, until a single factorisation takes a second.
    """

    def __init__(self, nlp: Mapping[str, Any]) -> None:
        ca.Callback.__init__(self)
        self._nlp = nlp
        self._cost, self._multipliers = ca.nlpsol_out().index('f'), ca.nlpsol_out().index('lam_g')
        self.construct('clock', {})

    def begin(self, budget: Budget, iterations: float) -> None:
        """Begin a run of at most so many iterations."""
        self._budget, self._most, self.iterations = budget, iterations, 0

    def get_n_in(self) -> int:
        """Return the number of what Ipopt tells."""
        return int(ca.nlpsol_n_out())

    def get_sparsity_in(self, i: int) -> Any:
        """Return the shape of what it tells."""
        return self._nlp[ca.nlpsol_out(i).removeprefix('lam_')].sparsity()

    def eval(self, values: Sequence[Any]) -> list[int]:  # noqa: A003
        """Return whether to stop."""
        self.iterations += 1
        if self.iterations % _CHECK_PERIOD == 0:
            size = 1.0 + abs(float(values[self._cost]))
            if not float(np.abs(values[self._multipliers].full()).max()) < _HOPELESS * size:
                return [1]
        return [int(self._budget.spent or self.iterations > self._most)]

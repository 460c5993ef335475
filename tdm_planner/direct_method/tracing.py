# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What a user states, traced by CasADi: one graph a function, with exact derivatives.

A function of a formulation is called once with symbols in place of numbers; the graph that comes
back is evaluated ever after. The numbers of the problem (floats among its fields) are arguments of
the graph, so that one trace serves all problems of a kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
import copy
import dataclasses
from hashlib import sha256
import threading
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.graphs import Bends, Call, Unfolded
from tdm_planner.direct_method.hints import ARGUMENTS, suspect, told
from tdm_planner.direct_method.integrator import Integrator
from tdm_planner.exceptions import InvalidProblem

T = TypeVar('T')

_SAMPLES = 7
_TRACES_KEPT, _ALIKE_KEPT = 64, 3  # kinds of problems; others of a kind, by their numbers
_TRACE_ROUNDING = 1e-9, 1e-11  # by which what is traced may differ from numpy: share, at least
_DATA = int, float, str, tuple, list, dict, np.ndarray, np.generic  # attributes functions may use
_ALONE = 'it must depend on its arguments at the same node alone'
_LOCK = threading.RLock()  # a statement may solve another problem


def _expected(stated: CheckedFormulation) -> dict[str, tuple[list[Array], list[str], Array]]:
    """
    Return what numpy gives of every function at some nodes, to compare a trace with.

    By function: its arguments (K, n) but for the numbers, what it gives by name, and that (K, m).
    The nodes are near the straight way between the boundary conditions, at random.
    """
    rng, s = np.random.default_rng(0), np.linspace(0.1, 0.9, _SAMPLES)
    duration = stated.duration().guess
    outputs = {}
    for name, output in stated.outputs().items():
        start, end = (output.conditions(where).get(0) for where in ('start', 'end'))
        known = [value for value in (start, end) if value is not None] or [0.0]
        first, last = known[0], known[-1]
        size = output.scale or abs(last - first) or max(1.0, abs(first))
        jet = [
            0.3 * size * rng.normal(size=s.size) / duration**order
            for order in range(output.derivatives + 1)
        ]
        jet[0] += first + (last - first) * s
        outputs[name] = jet
    integrated = {
        name: state.start + 0.3 * state.scale * rng.normal(size=s.size)
        for name, state in stated.integrated().items()
    }

    def columns(values: Iterable[Any]) -> Array:
        return np.array([np.asarray(v, dtype=float) for v in values]).reshape(-1, s.size).T

    t = duration * s
    x, u = stated.invert(outputs, integrated)
    parts = {'y': outputs, 'z': integrated, 't': t, 'x': x, 'u': u}
    y, z = columns(v for jet in outputs.values() for v in jet), columns(integrated.values())
    given = {'y': y, 'z': z, 't': columns([t]), 'x': x.astype(float), 'u': u.astype(float)}
    found = {}
    for function, names in ARGUMENTS.items():
        values = stated.values(function, *(parts[name] for name in names))
        wanted = columns(values.values())
        found[function] = [given[name] for name in names], list(values), wanted
    return found


class Trace:
    """
    The functions of a formulation as CasADi functions of one node.

    `invert` (y, z, p) -> x, u with y the outputs' derivatives by time one after the other;
    `rates` (x, u, p) -> (nx,), `margins` and `running` (t, x, u, p), `final`, `start_conditions`
    and `end_conditions` (t, x, p); p are the `values` of the problem's `symbolic` numbers.
    `unused` names outputs without a part in `invert`; `uses` tells which limits use t, x, u.

    What cannot be traced, or traces to other numbers, raises InvalidProblem, naming function and
    line.
    """

    _made: ClassVar[dict[Any, list[Trace]]] = {}

    def __init__(self, stated: CheckedFormulation, symbolic: Sequence[str]) -> None:
        found = numbers(stated.formulation)
        self.symbolic = tuple(symbolic)
        self.fixed = {name: value for name, value in found.items() if name not in symbolic}
        self.margin_names = stated.limit_names
        self.units = stated.formulation.state_units, stated.formulation.control_units
        self._made_of_it: dict[Any, Any] = {}
        symbols = {name: ca.SX.sym(name, found[name].size) for name in symbolic}
        twin = CheckedFormulation(symbolic_copy(stated.formulation, symbols))
        vars(twin)['control_limits'] = stated.control_limits  # which of them are finite
        p = ca.vertcat(*symbols.values()) if symbols else ca.SX(0, 1)
        outputs, integrated = stated.outputs(), stated.integrated()
        nx, nu = len(stated.state_names), len(stated.control_names)
        t, x, u = ca.SX.sym('t'), ca.SX.sym('x', nx), ca.SX.sym('u', nu)
        jets = {n: ca.SX.sym(n, o.derivatives + 1) for n, o in outputs.items()}
        z = ca.SX.sym('z', len(integrated))
        zs = dict(zip(integrated, ca.vertsplit(z), strict=True)) if integrated else {}
        symbolic_of = {'y': ca.vertcat(*jets.values()), 'z': z, 't': t, 'x': x, 'u': u}
        parts = {'y': {n: ca.vertsplit(jet) for n, jet in jets.items()}, 'z': zs, 't': t}
        parts |= {'x': ca.vertsplit(x), 'u': ca.vertsplit(u)}
        self.functions = {
            function: _traced(
                twin,
                function,
                [*(symbolic_of[name] for name in names), p],
                tuple(parts[name] for name in names),
            )
            for function, names in ARGUMENTS.items()
        }
        self.invert, self.rates, self.margins, self.running, *ends = self.functions.values()
        self.final, self.start_conditions, self.end_conditions = ends
        limits, varied = self.margins(t, x, u, p), ca.vertcat(t, x, u)
        self.uses = uses = np.array([_depends(limits, v) for v in ca.vertsplit(varied)]).T
        self.of_states, self.of_controls = (part.any(1) for part in np.hsplit(uses, [1 + nx]))
        followed = self.invert(symbolic_of['y'], z, p)
        self.unused = [name for name, jet in jets.items() if not _depends(followed, jet).any()]
        self.unfolded = Unfolded(self.margins, values := self.values(stated.formulation))
        self._controls_bend = Bends(self.margins, 'u')
        self.kept_between = self.of_states | self._controls_bend(values)
        self.obstacles = Bends(self.margins, 'x')  # gives the mask of limits (nm,)
        self.flow = self._flow(list(outputs.values()), list(integrated), stated.state_names, z, p)

    def _flow(
        self, outputs: list[Any], integrated: list[str], names: Sequence[str], z: Any, p: Any
    ) -> Any:
        """Return (y with one more derivative each, z, p) -> rates by `invert`, and stated ones."""
        jets = [ca.SX.sym('y', output.derivatives + 2) for output in outputs]
        y = ca.vertcat(*(jet[:-1] for jet in jets))
        both = self.invert(y, z, p)
        x, u = ca.vertsplit(both, [0, len(names), both.numel()])
        rates = self.rates(x, u, p)
        slopes = [rates[names.index(name)] for name in integrated]
        along = ca.vertcat(*(jet[1:] for jet in jets), *slopes)
        by_inverse = ca.jacobian(x, ca.vertcat(y, z)) @ along
        return ca.Function('flow', [ca.vertcat(*jets), z, p], [ca.densify(by_inverse), rates])

    @classmethod
    def of(cls, stated: CheckedFormulation, compared: bool = False) -> Trace:
        """
        Return the trace of this kind of problem; a new one is compared with numpy.

        If `compared`, a known one is, too: functions may use more than a kind tells, as variables
        of their module.
        """
        with _LOCK:
            found = numbers(stated.formulation)
            key = _kind(stated, found)
            known = [t for t in cls._made.get(key, ()) if t._serves(stated.formulation, found)]
            if known and not compared:
                return known[0]
            expected = _expected(stated)
            for trace in known:
                with suppress(InvalidProblem):
                    _compare(trace, stated, expected)
                    break
            else:
                trace = _make(stated, expected, list(found))
                if len(cls._made) >= _TRACES_KEPT:
                    cls._made.clear()
            others = [other for other in cls._made.get(key, ()) if other is not trace]
            cls._made[key] = [trace, *others[:_ALIKE_KEPT]]
            return trace

    def _serves(self, formulation: Formulation, found: Mapping[str, Array]) -> bool:
        """Whether it was made for such numbers as are `found` in a formulation of its kind."""
        p, fixed = self.values(formulation), self.fixed.items()
        alike = all(np.array_equal(found[name], value) for name, value in fixed)
        alike = alike and self.unfolded.takes_same_branches(p)
        return alike and bool((self._controls_bend(p) <= self.kept_between).all())

    def once(self, key: Any, make: Callable[[], T]) -> T:
        """Return what else is made of this trace, once for every key."""
        if key not in self._made_of_it:
            self._made_of_it[key] = make()
        made: T = self._made_of_it[key]
        return made

    def cost_along(self, numbers: Array, times: Array, states: Array, controls: Array) -> float:
        """
        Return J of a motion given at begin, middle and end of its m intervals.

        Shapes: `times` (m, 3), `states` (m, 3, nx), `controls` (m, 3, nu), which may jump between
        intervals. By Simpson's rule.
        """
        t, x, u = (a.reshape(times.size, -1) for a in (times, states, controls))
        rows = Call(self.running, times.size)(t, x, u, numbers)[0].reshape(-1, 3)
        final = Call(self.final)(t[-1], x[-1], numbers)[0]
        return float((times[:, 2] - times[:, 0]) @ (rows @ [1.0, 4.0, 1.0]) / 6.0 + final[0])

    def cost_through(self, numbers: Array, times: Array, states: Array, controls: Array) -> float:
        """Return J of a motion at ends and middles of intervals, in turn: an odd number (n,)."""
        at = np.arange(times.size // 2)[:, None] * 2 + np.arange(3)
        return self.cost_along(numbers, times[at], states[at], controls[at])

    @property
    def integrator(self) -> Integrator:
        """Return the replay of this kind, made once."""
        return self.once(Integrator, lambda: Integrator(self.rates))

    def values(self, formulation: Formulation) -> Array:
        """Return the numbers that are arguments of the traced functions, (p,)."""
        return np.concatenate([np.zeros(0), *map(numbers(formulation).get, self.symbolic)])


def numbers(formulation: Any) -> dict[str, Array]:
    """Floats, and sequences of numbers, among a dataclass's fields by dotted name, (n,) each."""
    found: dict[str, Array] = {}
    for path, value in _members(formulation):
        several = (value,) if isinstance(value, float) else value
        listed = isinstance(several, list | tuple) and len(several) > 0
        if listed and all(isinstance(v, int | float) and not isinstance(v, bool) for v in several):
            found[path] = np.array(several, dtype=float)
    return found


def _members(formulation: Any, path: str = '') -> Iterator[tuple[str, Any]]:
    """Yield a statement, its fields, and theirs where one is a dataclass, by dotted name."""
    yield path, formulation
    for name, value in _fields(formulation).items():
        yield from _members(value, f'{path}.{name}'.lstrip('.'))


def _fields(formulation: Any) -> dict[str, Any]:
    """Values of a dataclass's fields; how it is solved is no part of the statement."""
    found = dataclasses.fields(formulation) if dataclasses.is_dataclass(formulation) else ()
    return {item.name: getattr(formulation, item.name) for item in found if item.name != 'solver'}


def symbolic_copy(formulation: Any, symbols: Mapping[str, Any], prefix: str = '') -> Any:
    """Return a copy with symbols for some of its numbers, not validated."""
    twin, fields = copy.copy(formulation), _fields(formulation)
    if not dataclasses.is_dataclass(formulation):
        return twin
    for name in {*getattr(twin, '__dict__', ())} - {*fields, 'solver'}:
        del twin.__dict__[name]  # what was computed from the numbers before
    for name, value in fields.items():
        found, path = value, prefix + name
        if path in symbols:
            parts = ca.vertsplit(symbols[path])
            found = parts[0] if isinstance(value, float) else type(value)(parts)
        elif dataclasses.is_dataclass(value):
            found = symbolic_copy(value, symbols, f'{path}.')
        object.__setattr__(twin, name, found)
    return twin


def _kind(stated: CheckedFormulation, found: Mapping[str, Array]) -> tuple[Any, ...]:
    """Return what a trace depends on beside numbers."""
    formulation = stated.formulation
    if not dataclasses.is_dataclass(formulation):
        return (formulation,)
    outputs = [(name, output.derivatives) for name, output in stated.outputs().items()]
    sizes = [(name, value.size) for name, value in found.items()]
    members = [*_members(formulation)]
    kinds = [type(value) for _, value in members if dataclasses.is_dataclass(value)]
    rest = [m for m in members if not (m[0] in found or dataclasses.is_dataclass(m[1]))]
    own = [
        (name, value)
        for kind in kinds
        for name in dir(kind)
        if isinstance(value := getattr(kind, name), _DATA) and not name.startswith('__')
    ]
    parts = (outputs, list(stated.integrated()), stated.limit_names, sizes, rest, own)
    return *kinds, repr(_told(parts))


def _told(value: Any) -> Any:
    """Return a value as `repr` tells it: of arrays all, in little."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, sha256(value.tobytes()).hexdigest()
    return [_told(part) for part in value] if isinstance(value, list | tuple) else value


def _make(stated: CheckedFormulation, expected: Mapping[str, Any], names: list[str]) -> Trace:
    """Trace; numbers that cannot be symbols (`if` or math on a parameter) are kept as numbers."""

    def attempt(symbolic: list[str]) -> Trace | InvalidProblem:
        try:
            trace = Trace(stated, symbolic)
            _compare(trace, stated, expected)
            return trace
        except InvalidProblem as error:
            return error

    trace = attempt(names)
    if isinstance(trace, InvalidProblem):
        plain = attempt([])
        if isinstance(plain, InvalidProblem):
            raise plain
        trace = attempt([name for name in names if isinstance(attempt([name]), Trace)])
        if isinstance(trace, InvalidProblem):
            trace = plain
    return trace


@contextmanager
def _no_numbers() -> Iterator[None]:
    """Make the conversion of a symbol to a number an error: CasADi gives NaN, silently."""

    def refuse(self: Any) -> float:
        raise TypeError('the value of a symbol is not known while it is traced')

    symbol: Any = ca.SX
    before = symbol.__float__
    symbol.__float__ = refuse
    try:
        yield
    finally:
        symbol.__float__ = before


def _traced(
    twin: CheckedFormulation, function: str, inputs: list[Any], arguments: tuple[Any, ...]
) -> Any:
    """
    Return the CasADi function of `inputs` that a function of symbols gives.

    Where it stacks them they are arrays of one; where it computes several at once, one array.
    """
    errors = []
    for given in (arguments, map(_boxed, arguments), map(_together, arguments)):
        try:
            with _no_numbers():
                column = _column(twin.symbolic(function, *given))
            made = ca.Function(function, inputs, [column], {'allow_free': True})
            if made.has_free():
                kind = type(twin.formulation).__name__
                raise InvalidProblem(f'{function} of {kind} keeps values of other calls: {_ALONE}')
            return made
        except InvalidProblem:
            raise
        except Exception as error:  # noqa: B902
            errors.append(error)  # whatever the user's function raises
    raise InvalidProblem(told(twin.formulation, function, errors[0], traced=True)) from errors[0]


def _boxed(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _boxed(part) for name, part in value.items()}
    return [_boxed(part) for part in value] if isinstance(value, list) else _together([value])


def _together(value: Any) -> Any:
    listed = isinstance(value, list)
    return np.fromiter(value, dtype=object, count=len(value)) if listed else value


def _column(values: Sequence[Any]) -> Any:
    """Stack scalars: symbols, numbers or arrays of one of them."""
    rows = (v.item() if isinstance(v, np.ndarray | np.generic) else v for v in values)
    return ca.densify(ca.vertcat(ca.SX(0, 1), *map(ca.SX, rows)))


def _depends(values: Any, on: Any) -> Mask:
    which: Any = ca.which_depends  # typed in some versions only
    return np.array(which(values, on, 1, True), dtype=bool)


def _compare(trace: Trace, stated: CheckedFormulation, expected: Mapping[str, Any]) -> None:
    """Raise InvalidProblem where the trace gives other numbers than numpy."""
    p, (share, least) = np.tile(trace.values(stated.formulation), (_SAMPLES, 1)), _TRACE_ROUNDING
    for function, (given, names, wanted) in expected.items():
        (found,) = Call(trace.functions[function], _SAMPLES)(*given, p)
        what = f'{function} of {type(stated.formulation).__name__} gives'
        if found.shape != wanted.shape:
            raise InvalidProblem(
                f'{what} {found.shape[1]} values when it is traced, but {wanted.shape[1]} with '
                f'numpy: {_ALONE}'
            )
        same = np.isclose(found, wanted, rtol=share, atol=least, equal_nan=True)
        if not same.all():
            node, column = np.argwhere(~same)[0]
            number = float(wanted[node, column])
            reason = 'write a formula that gives numbers there'
            if np.isfinite(number):
                reason = suspect(stated.formulation, function) or _ALONE
            raise InvalidProblem(
                f'{what} {names[column]} = {found[node, column]:.10g} when it is traced, but '
                f'{number:.10g} with numpy: {reason}'
            )

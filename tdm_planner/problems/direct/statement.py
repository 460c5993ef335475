# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a `Formulation` states beside its equations: whether it can be used, and its limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import partial
import math
from numbers import Real
from typing import Any

import numpy as np
from tdm_planner.arrays import Array, largest_of_unit, Mask
from tdm_planner.direct_method.arc_basis import ArcMotion
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.direct_method.formulation import checked_integer, Formulation
from tdm_planner.direct_method.graphs import Call
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import short, specifications
from tdm_planner.problems.direct.plant import DirectPlant, END_TOLERANCE
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint

Left = Mapping[str, tuple[float | None, float | None]]  # of limits at start and end

CONDITIONS = 'start_conditions', 'end_conditions'  # checked one by one, 'end_conditions 0'
MARGIN_TOLERANCE = 1e-5  # for an end that is exactly on a limit
# Share by which ends are moved to see what rounding does to limits, as x^2 + y^2 - r^2; how often.
_ROUNDING, _MARGIN_LOOKS = 1e-12, 4
# Share by which rates differ where two statements contradict each other, 1e-12 where they do not;
# that from which nothing is planned: `invert` may round what has a kink in `derivative`.
_CONTRADICTED, _REFUSED = 1e-4, 1e-2
_NEAR, _MOVED = 1e-9, 10.0  # share by which states are moved to see rounding; times its effect
# Of the range of a cost between two looks; looks between these, turns, to find where it is.
_JUMP, _LOOKS, _TURNS = 0.05, 33, 8
_TINY = 1e-12  # share of the largest weight that an eigenvalue may be off by
_NODES = 5, 10_000
_STARTS = 1, 10_000
_CLIPPED = 1e-3  # share of the largest start of a unit (or of 1) by which motions begin elsewhere


def check_statement(problem: Formulation) -> None:
    """
    Check performance index, units, tolerance and the numbers of nodes and starts.

    Raise InvalidProblem, naming what is missing or not allowed.
    """
    costs = 'final_cost', 'running_cost'
    if all(getattr(type(problem), cost) is getattr(Formulation, cost) for cost in costs):
        raise InvalidProblem(
            f'{problem.name} states no performance index: define final_cost or running_cost'
        )
    stated = CheckedFormulation(problem)
    for kind, names, example in (
        ('state', stated.state_names, "('m', 'm/s')"),
        ('control', stated.control_names, "('N',)"),
    ):
        units = stated.strings(f'{kind}_units', 'units', example)
        if len(names) != len(units):
            raise InvalidProblem(
                f'{problem.name} has {len(names)} {kind}_names but {len(units)} {kind}_units'
            )
    checked_integer(stated.attribute('nodes'), 'nodes', *_NODES)
    checked_integer(stated.attribute('starts'), 'starts', *_STARTS)
    tolerance: Sequence[float] | None = stated.attribute('terminal_tolerance')
    count = len(stated.state_names)
    if tolerance is not None:
        values = list(tolerance) if np.iterable(tolerance) else []
        known = all(isinstance(v, Real) and not isinstance(v, bool) and v > 0 for v in values)
        if len(values) != count or not known:
            raise InvalidProblem(
                f'terminal_tolerance = {short(tolerance)} is not allowed: must be {count} '
                'positive numbers, one for each state, inf where any end will do'
            )
    given = stated.call('feedback_weights')
    if given is not None:
        _check_weights(given, len(stated.state_names), len(stated.control_names))


def _check_weights(given: Any, *sizes: int) -> None:
    """Check the pair of weights Q and R; raise InvalidProblem saying what is wrong with which."""
    pair = list(given) if np.iterable(given) else []
    if len(pair) != 2:
        raise InvalidProblem(f'feedback_weights gives {short(given)}, expected a pair (Q, R)')
    for what, weights, count in zip('QR', pair, sizes, strict=True):
        try:
            matrix = np.atleast_2d(np.asarray(weights, dtype=float))
        except (TypeError, ValueError):
            raise InvalidProblem(f'feedback_weights gives {what} that is no matrix') from None
        if matrix.shape != (count, count):
            raise InvalidProblem(
                f'feedback_weights gives {what} of shape {matrix.shape}, expected {(count, count)}'
            )
        rounding = _TINY * np.abs(matrix).max()
        fits = np.isfinite(rounding) and np.allclose(matrix, matrix.T, atol=rounding)
        least = np.linalg.eigvalsh(matrix).min() if fits else -np.inf
        if not (least > rounding if what == 'R' else least >= -rounding):
            kind = 'definite' if what == 'R' else 'semidefinite'
            raise InvalidProblem(f'feedback_weights gives {what} that is not positive {kind}')


@np.errstate(all='ignore')
def rates_of(
    program: Transcription, xi: Array, share: float = _CONTRADICTED
) -> tuple[Array, Array, Mask]:
    """
    Return the rates (nx,) by `invert` and by `derivative`, and which states' contradict (nx,).

    They are those of the node where they differ most, beyond a `share` of their size and rounding:
    what rates change by where states and controls do by a little. Kinks may be met at the ends,
    and by chance at a node between.
    """
    motion, numbers = program.motion(xi), program.trace.values(program.formulation)
    rng, both = np.random.default_rng(0), program.flow(xi)
    near = [v * (1.0 + _NEAR * rng.normal(size=v.shape)) for v in motion[1:]]
    moved = Call(program.trace.rates, motion.times.size)(*near, numbers)[0] - both[1]
    by_inverse, rates, moved = (values[1:-1] for values in (*both, moved))
    sizes, differ = np.abs(by_inverse) + np.abs(rates), np.abs(by_inverse - rates)
    finite = np.isfinite(differ + moved)
    sizes = np.where(finite, sizes, 0.0)
    allowed = share * np.maximum(sizes, np.median(sizes, axis=0)) + _MOVED * np.abs(moved)
    excess = np.where(finite, differ - allowed, 0.0)
    wrong = (excess > 0.0).sum(axis=0) > 1
    node = np.argmax(np.where(wrong, excess, sizes), axis=0), np.arange(wrong.size)
    return by_inverse[node], rates[node], wrong


def check_dynamics(program: Transcription, candidates: Iterable[Array]) -> None:
    """
    Check that `invert` and `derivative` state the same motion along one of the candidates.

    Raise InvalidProblem, naming the first state whose rates differ: along all of them, as some may
    be no motions of the plant, such as a flow out of an empty tank.
    """
    for xi in candidates:
        inverse, rates, wrong = rates_of(program, xi, _REFUSED)
        if not wrong.any():
            return
    first = int(np.argmax(wrong))
    raise InvalidProblem(
        f"derivative gives the rate of '{program.formulation.state_names[first]}' = "
        f'{rates[first]:.6g} where the states of invert change by {inverse[first]:.6g}: one of '
        'the two is wrong (`tdm check` compares all of them)'
    )


def check_use(trace: Trace) -> None:
    """
    Raise InvalidProblem, naming the limit or output, if it has no part in the motion.

    A limit depends on t, x or u; `invert` uses every output.
    """
    for index in np.flatnonzero(~(trace.of_states | trace.of_controls)):
        raise InvalidProblem(
            f"margins gives '{trace.margin_names[index]}' the same value whatever the motion: a "
            'limit must depend on t, x or u; remove it'
        )
    for name in trace.unused:
        raise InvalidProblem(
            f"invert does not use y['{name}']: states and controls must follow from every "
            'output; use it, or remove it from outputs'
        )


def check_costs(trace: Trace, motion: ArcMotion, numbers: Array) -> None:
    """Raise InvalidProblem, naming the function, if a cost has a jump along a motion."""
    points = np.column_stack([motion.times, motion.states, motion.controls])
    steps = np.linspace(0.0, points.shape[0] - 1.0, 8 * points.shape[0] + 1)
    nx = motion.states.shape[1]

    def cost(function: Any, places: Array) -> Array:
        nodes = np.arange(len(points))
        along = np.stack([np.interp(places, nodes, column) for column in points.T], axis=1)
        parts = np.split(along, [1, 1 + nx], axis=1)
        found = Call(function, places.size)(*parts[: function.n_in() - 1], numbers)[0]
        return np.array(found[:, 0])

    for name, function in (('running_cost', trace.running), ('final_cost', trace.final)):
        values = cost(function, steps)
        finite = values[np.isfinite(values)]
        rounding = _NEAR * np.abs(finite).max(initial=0.0)
        jumps = np.nan_to_num(np.abs(np.diff(values)))
        if not jumps.max() > max(rounding, _JUMP * np.ptp(finite) if finite.size else 0.0):
            continue
        places, apart = steps, jumps
        for _ in range(_TURNS):
            at = int(np.argmax(apart))
            places = np.linspace(places[at], places[at + 1], _LOOKS)
            apart = np.abs(np.diff(cost(function, places)))
            # What is only steep flattens out, at a pole it grows.
            if not 0.5 * jumps.max() < apart.max() < 2.0 * jumps.max():
                break
        else:
            jump = apart.max()
            raise InvalidProblem(
                f'{name} jumps by {jump:.3g} along the initial guess: the '
                'performance index must be continuous, a steep slope such as np.tanh in place of '
                'a step'
            )


def margins_at_ends(plant: DirectPlant) -> Left:
    """Return what is left to every limit at both ends, None where that depends on what is free."""
    stated, ends = plant.stated, plant.ends
    duration, rng = stated.duration(), np.random.default_rng(0)
    given = np.nan_to_num(ends.states), np.nan_to_num(ends.controls)

    def margins(share: float) -> Array:
        near = (v * (1.0 + share * rng.normal(size=v.shape)) for v in given)
        found = stated.margins(np.array([0.0, duration.guess]), *near)
        return np.array(list(found.values()), dtype=float).reshape(-1, 2)

    with np.errstate(all='ignore'):
        exact = margins(0.0)
        rounding = np.max([np.abs(margins(_ROUNDING) - exact) for _ in range(_MARGIN_LOOKS)], 0)
    left = np.where(np.abs(exact) <= rounding, 0.0, exact).astype(object)
    left[ends.opens(plant.trace.uses, duration).T | ~np.isfinite(exact)] = None
    return {
        name: (first, last)
        for name, (first, last) in zip(stated.limit_names, left.tolist(), strict=True)
    }


def violations_at_ends(plant: DirectPlant, left: Left) -> Iterator[str]:
    """Say what no motion can keep at its ends; `left` by `margins_at_ends`."""
    yield from _begun_elsewhere(plant.stated, plant.ends)
    for side, where in enumerate(('start', 'end')):
        for name, values in left.items():
            if (value := values[side]) is not None and value < -MARGIN_TOLERANCE:
                size, unit = plant.stated.size_of(name)
                yield (
                    f"the {where} violates the limit '{name}' by {-value * size:.3g}"
                    f'{unit and " "}{unit}, whatever the motion: change the {where} or the limit'
                )


def _begun_elsewhere(stated: CheckedFormulation, ends: Ends) -> list[str]:
    """
    Say in which states every motion begins elsewhere than the group `start` has it.

    Measured states are put into that group: the plant would be planned for from elsewhere. What is
    measured may be clipped by a little, or given in another unit.
    """
    start: Any = getattr(stated.formulation, 'start', None)
    given = specifications(type(start)) if is_dataclass(start) else {}
    reasons, units = [], stated.formulation.state_units
    sizes = largest_of_unit(np.abs(np.nan_to_num(ends.states[0])), units)
    states = zip(stated.state_names, units, ends.states[0], sizes, strict=True)
    for name, unit, begins, size in states:
        if np.isnan(begins) or name not in given or given[name].unit not in ('', unit):
            continue
        value = getattr(start, name)
        if not isinstance(value, int | float) or abs(begins - value) <= _CLIPPED * max(1.0, size):
            continue
        turns = (begins - value) / math.tau
        whole = unit == 'rad' and math.isclose(turns, round(turns), rel_tol=1e-6)
        reasons.append(
            f'start.{name} = {value:.7g}, but every motion begins with {name} = {begins:.7g}'
            + (', by whole turns' if whole else '')
            + f': outputs() or integrated() must begin with self.start.{name}, and invert give it'
        )
    return reasons


def check_ends(plant: DirectPlant) -> Left:
    """Return what `margins_at_ends` does; InvalidProblem for what no motion can keep there."""
    left = margins_at_ends(plant)
    for reason in violations_at_ends(plant, left):
        raise InvalidProblem(reason)
    return left


def short_of_reserve(stated: CheckedFormulation, left: Left, where: str) -> list[str]:
    """Say of which limits an end leaves less than the reserve; `left` by `margins_at_ends`."""
    side = ('start', 'end').index(where)
    return [
        f"the {where} leaves {value:.3g} to the limit '{name}', less than its reserve {share:g}"
        for (name, both), share in zip(left.items(), stated.reserves(tuple(left)), strict=True)
        if (value := both[side]) is not None and 0.0 <= value < share
    ]


def limits_of(
    stated: CheckedFormulation, trajectory: Trajectory, tolerances: Array | float = 0.0
) -> tuple[Constraint, ...]:
    """Return the limits on a trajectory, one constraint each, and what they may be violated by."""
    last: list[Any] = [None, {}]  # all limits are checked at the same instants, one by one

    def margin(name: str, times: Array, states: Array, controls: Array) -> Array:
        if times is not last[0]:
            last[:] = times, stated.margins(times, states, controls)
        found: Array = last[1][name]
        return found

    names = list(stated.margins(trajectory.times, trajectory.states, trajectory.controls))
    found = []
    for name, least in zip(names, np.broadcast_to(tolerances, len(names)).tolist(), strict=True):
        size, unit = stated.size_of(name)
        scaled = unit if size == 1.0 or not unit else f'x {size:g} {unit}'
        found.append(Constraint(name, partial(margin, name), least, scaled))
    return tuple(found)


def constraints_of(
    stated: CheckedFormulation, trajectory: Trajectory, tolerances: Array
) -> tuple[Constraint, ...]:
    """Return what a plan is checked for: its limits, and the conditions at both ends."""

    def missed(
        function: str, at: slice, index: int, times: Array, states: Array, controls: Array
    ) -> Array:
        left = np.full(times.size, END_TOLERANCE)
        left[at] -= np.abs(stated.parts(function, times[at], states[at])[index])
        return left

    found = list(limits_of(stated, trajectory, tolerances))
    first = trajectory.times[:1], trajectory.states[:1]
    for function, at in zip(CONDITIONS, (slice(0, 1), slice(-1, None)), strict=True):
        for index in range(len(stated.parts(function, *first))):
            found.append(Constraint(f'{function} {index}', partial(missed, function, at, index)))
    return tuple(found)

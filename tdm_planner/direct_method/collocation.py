# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Refinement of a motion by direct collocation, from the same traced statement.

Hermite-Simpson in separated form: states at the ends and in the middle of every interval,
controls linear in each, so that what is optimised is what is published and replayed. Ipopt solves
the program, by CasADi's exact derivatives. See Betts, *Practical Methods for Optimal Control Using
Nonlinear Programming*, chapter 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import threading
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from tdm_planner.arrays import Array, largest_of_unit, Mask
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation_program import CollocationProgram
from tdm_planner.direct_method.formulation import Duration
from tdm_planner.direct_method.graphs import Call, IpoptStop
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.trajectory import to_nanoseconds

# A state or control is scaled by its size along the guess, or by a share of the largest of its
# unit; where all of those are nearly zero, of the largest of all.
_SCALE_SHARE, _NEARLY_ZERO = 1e-3, 1e-6
_LEAST_KINK = 1e-9  # by which a kink is rounded
_SMALL_LIMIT, _NO_LIMIT = 1e-2, 1e-13  # sizes along the guess between which limits are scaled
_FILLS, _ROUNDING = 24, 1e-9  # of free boundary values; share by which they change nothing
LIMITS_ROUNDING = 1e-6  # share of a limit's kinks: enough for a slope where something is at rest
_IPOPT: dict[str, Any] = {
    'print_level': 0,
    'sb': 'yes',
    'tol': 1e-5,
    'constr_viol_tol': 1e-7,
    'acceptable_iter': 0,
    'max_iter': 10_000,  # the clock stops it before
    'mu_strategy': 'monotone',
    'barrier_tol_factor': 30.0,  # how roughly the first barrier problems are solved
    'min_refinement_steps': 0,  # of a linear solution that is good as it is
    # The program is scaled; for its size a plain ordering is the quickest.
    'mumps_scaling': 0,
    'mumps_permuting_scaling': 0,
    'mumps_pivot_order': 0,
}
_PATIENT = 2.5  # times the iterations of those who wait
# From the solution of nearly the same program, with its multipliers.
_AGAIN = dict.fromkeys(('mu_init', 'warm_start_bound_push', 'warm_start_slack_bound_push'), 1e-6)


@dataclass(frozen=True)
class Settings:
    """
    How a program is solved: most `iterations` of Ipopt, its first barrier parameter `barrier`.

    `smoothing` is the share of J that is charged for the controls' changes: where they do not
    matter they rest. `rounding` rounds kinks of the running cost and of the rates, as |a| to
    sqrt(a^2 + e^2): e is that share of the largest |a| along the guess, see `graphs.Rounded`.
    """

    iterations: int
    barrier: float
    smoothing: float
    rounding: float


COLD = Settings(iterations=80, barrier=1e-1, smoothing=1e-3, rounding=1e-2)
WARM = Settings(iterations=100, barrier=1e-3, smoothing=1e-4, rounding=1e-3)


@dataclass(frozen=True, eq=False)
class CollocatedMotion:
    """
    A motion on n even intervals: `states` (n + 1, nx), `middles` (n, nx), `controls` (n + 1, nu).

    `duration` [s]; `cost` is its J, and `size` that of J without its constant part: decisions do
    not depend on that, nor on the unit of J. A solution near it on as many intervals begins with
    its `multipliers`, of the variables and of the rows.
    """

    states: Array
    middles: Array
    controls: Array
    duration: float
    cost: float = np.inf
    size: float = np.inf
    multipliers: tuple[Array, ...] = ()

    @property
    def intervals(self) -> int:
        """Return n."""
        return len(self.middles)

    @property
    def times(self) -> Array:
        """
        Return the instants of the ends, (n + 1,) [s], as they are published: in whole nanoseconds.

        Where a plant is unstable a nanosecond at a switch may be a degree at the end.
        """
        return to_nanoseconds(np.linspace(0.0, self.duration, self.intervals + 1))

    @property
    def halves(self) -> tuple[Array, Array, Array]:
        """Return instants (2 n + 1,), states and controls at the ends and middles, in turn."""
        controls = np.repeat(self.controls, 2, axis=0)[:-1]
        controls[1::2] = 0.5 * (self.controls[:-1] + self.controls[1:])
        states = np.repeat(self.states, 2, axis=0)[:-1]
        states[1::2] = self.middles
        return np.linspace(0.0, self.duration, len(states)), states, controls

    def on(self, intervals: int, rates: Array) -> CollocatedMotion:
        """
        Return it on other intervals: cubics with the `rates` (n + 1, nx), linear controls.

        Where a cubic overshoots the rates may not be defined: states keep to the range they had.
        """
        s, at = (np.linspace(0.0, 1.0, k + 1) for k in (self.intervals, 2 * intervals))
        cubic = CubicHermiteSpline(s, self.states, rates * self.duration)
        known = np.vstack([self.states, self.middles])
        states = np.clip(cubic(at), known.min(axis=0), known.max(axis=0))
        controls = np.stack([np.interp(at[::2], s, u) for u in self.controls.T], axis=-1)
        return CollocatedMotion(states[::2], states[1::2], controls, self.duration)


@dataclass(frozen=True, eq=False)
class Ends:
    """
    What the boundary conditions say of states (2, nx) and controls (2, nu); NaN where free.

    `unkept` names the conditions that fix neither a state nor a control, or none that others do
    not fix: collocation cannot keep them. `regular` where `invert` gives numbers at both ends.
    """

    states: Array
    controls: Array
    unkept: tuple[str, ...] = ()
    regular: bool = True

    @classmethod
    def of(cls, stated: CheckedFormulation) -> Ends:
        """
        Return what `invert` makes of the boundary values.

        A component is given if the free boundary values, varied at random, do not change it. Many
        are tried: arctan2 of 0 and a value is 0 for half of them.
        """
        rng, n, states, controls = np.random.default_rng(1), _FILLS, [], []
        unkept, regular = list[str](), True
        for side, where in enumerate(('start', 'end')):
            y = {}
            for name, output in stated.outputs().items():
                given, scale = output.conditions(where), output.scale or 1.0
                y[name] = [
                    np.full(n, given[order]) if order in given else scale * rng.normal(size=n)
                    for order in range(output.derivatives + 1)
                ]
            z = {}
            for name, state in stated.integrated().items():
                value = state.start if side == 0 else state.end
                free = state.scale * rng.normal(size=n)
                z[name] = free if value is None else np.full(n, float(value))
            both = _inverted(stated, y, z)
            # What is about there, to tell a small component from a zero with rounding errors.
            near_y = {name: [_about(rng, jet) for jet in jets] for name, jets in y.items()}
            near = _inverted(stated, near_y, {name: _about(rng, z[name]) for name in z})
            usual = np.median(np.abs(np.nan_to_num(near)), axis=0)
            sizes = np.fmax(np.abs(both).max(axis=0), usual)
            regular = regular and bool(np.isfinite(both).all())
            same = np.ptp(both, axis=0) <= _ROUNDING * sizes
            found = np.where(same, both[0], np.nan)
            first, last = np.split(found, [len(stated.state_names)])
            states.append(first)
            controls.append(last)
            changes = list[Array]()  # of what is given, by conditions that fix it
            either_way = np.resize([0.1, -0.1], n)
            for name, output in stated.outputs().items():
                for order in output.conditions(where):
                    jets = list(y[name])
                    if order <= output.derivatives:
                        jets[order] = jets[order] + either_way
                    slopes = (_inverted(stated, y | {name: jets}, z) - both) / either_way[:, None]
                    up, down = slopes[:2, same]  # beyond one of them there may be no value
                    change = np.nan_to_num(np.where(np.isfinite(up), up, down))
                    changes.append(change / (np.abs(change).max(initial=0.0) or 1.0))
                    if np.linalg.matrix_rank(changes) < len(changes):
                        changes.pop()
                        unkept.append(f"'{name}' of order {order} at the {where}")
        return cls(np.array(states), np.array(controls), tuple(unkept), regular)

    def opens(self, uses: Mask, duration: Duration) -> Mask:
        """
        Return which limits depend on what is free at the start, and at the end, (2, nm).

        `uses` tells which depend on t, states and controls, (nm, 1 + nx + nu).
        """
        times = np.array([[0.0], [0.0 if duration.fixed else np.nan]])
        given = np.hstack([times, self.states, self.controls])
        return np.array([(uses & np.isnan(values)).any(axis=1) for values in given])


def _about(rng: np.random.Generator, values: Array) -> Array:
    """Return random values as large as the given ones; about 1 in place of 0."""
    return np.asarray(np.where(values == 0.0, 1.0, values) * rng.normal(1.0, 1.0, values.size))


def _inverted(stated: CheckedFormulation, y: Any, z: Any) -> Array:
    """Return states and controls, (n, nx + nu)."""
    with np.errstate(all='ignore'):
        return np.hstack(stated.invert(y, z)).astype(float)


class Collocation:
    """
    The program of a traced statement on n `intervals`; made once a kind, for any numbers.

    `has_kinks` tells whether the running cost or the rates have any, `has_alternatives` whether
    one of two limits will do somewhere.
    """

    def __init__(self, trace: Trace, intervals: int, settings: Settings) -> None:
        self.trace, self.intervals, n = trace, intervals, intervals
        self._settings, self._lock = settings, threading.Lock()
        self._program = CollocationProgram(trace, intervals)
        running, motion, stated = rounded = self._program.pieces.rounded
        self.has_kinks = running.count + motion.count > 0
        self._either, self.has_alternatives = stated.either, bool(stated.either.any())
        self._limits = Call(trace.unfolded.rows, n + 1)
        self._rounded_limits = Call(stated.value, n + 1)
        self._kinks = [Call(one.sizes, n + 1) for one in rounded]
        ipopt = _IPOPT | {'mu_init': settings.barrier}
        # From near a solution the limits' multipliers begin where the barrier has them.
        ipopt['bound_mult_init_method'] = 'constant' if settings is COLD else 'mu-based'
        if settings is COLD:  # from a guess that is no motion the line search would stall
            ipopt['accept_after_max_steps'] = 3
        nlp = self._program.nlp
        self._clock = IpoptStop(nlp)
        options: dict[str, Any] = {
            'print_time': 0,
            'inputs_check': False,  # nor a warning where limits leave no freedom
            'show_eval_warnings': False,
            'calc_lam_p': False,
            'no_nlp_grad': True,
            'iteration_callback': self._clock,
            **self._program.derivatives,
        }
        again = ipopt | _AGAIN | {'warm_start_init_point': 'yes'}
        self._solver, self._again = (
            ca.nlpsol('collocation', 'ipopt', nlp, {**options, 'ipopt': given})
            for given in (ipopt, again)
        )

    @classmethod
    def of(cls, trace: Trace, intervals: int, settings: Settings) -> Collocation:
        """Return the program of this kind, made once."""
        return trace.once((cls, intervals, settings), lambda: cls(trace, intervals, settings))

    def solve(
        self,
        numbers: Array,
        guess: CollocatedMotion,
        ends: Ends,
        durations: tuple[float, float],
        kept: Array,
        budget: Budget,
        *,
        roughly: bool = False,
        patient: bool = False,
        unfinished: bool = False,
        alternatives: float = LIMITS_ROUNDING,
    ) -> CollocatedMotion | None:
        """
        Return the optimum near `guess`; None if Ipopt does not converge, unless `unfinished` does.

        `durations` are the shortest and the longest [s]; `kept` (n + 1, nm) is what must be left
        to every limit at the nodes, and between them. `roughly`: with kinks as smooth as at first;
        `patient`: with more iterations. `alternatives` is the smoothing, as a share, of kinks
        where satisfying either of two limits is enough.
        """
        n = self.intervals
        times = np.linspace(0.0, guess.duration, n + 1)[:, None]
        # A guess may be no motion at all: the ends count.
        states = _with_ends(guess.states, ends.states)
        controls = _with_ends(guess.controls, ends.controls)
        along = times, states, controls, numbers
        charge = COLD if roughly else self._settings
        of_limits = np.where(self._either, alternatives, LIMITS_ROUNDING)
        shares = charge.rounding, charge.rounding, of_limits
        running, motion, limits = self._kinks
        with self._lock:
            rows = self._limits(*along)[0].copy()
            inside = running(*along)[0], motion(*along[1:])[0], limits(*along)[0]
            largest = [np.abs(np.nan_to_num(v)).max(axis=0, initial=0.0) for v in inside]
            # How far the kinks of the running cost, the rates and the limits are rounded.
            kinks = [by * v + _LEAST_KINK for by, v in zip(shares, largest, strict=True)]
            rounding = np.nan_to_num(rows - self._rounded_limits(*along, kinks[2])[0])
        sl = np.abs(np.nan_to_num(rows, posinf=0.0, neginf=0.0)).max(axis=0)
        sl[(sl > _SMALL_LIMIT) | (sl < _NO_LIMIT)] = 1.0  # Ipopt itself scales what is large
        kept = kept[:, self.trace.unfolded.limit]
        # What is given may be on a limit, or in its kink, but for rounding.
        kept[[0, -1]] -= _IPOPT['constr_viol_tol'] * sl + np.maximum(rounding[[0, -1]], 0.0)
        x_units, u_units = self.trace.units
        sx, su, st = _scales(states, x_units), _scales(controls, u_units), guess.duration
        program = self._program
        bounds = []
        single = program.pieces.simple.bounds(numbers, kept)
        for bound, t in zip(single, durations, strict=True):
            x, u = np.split(bound, [sx.size], axis=1)
            m = 0.5 * (x[:-1] + x[1:])
            x, u = _with_ends(x, ends.states), _with_ends(u, ends.controls)
            bounds.append(np.concatenate([x / sx, m / sx, u / su, t / st], axis=None))
        lower, upper = bounds
        z = np.concatenate([states / sx, guess.middles / sx, controls / su, 1.0], axis=None)
        z = np.clip(z, lower, upper)
        least, most = program.rows(kept / sl)
        begun = replace(guess, states=states, controls=controls)
        given = np.concatenate([numbers, sx, su, sl, *kinks, [st, charge.smoothing, 1.0]])
        free = upper > lower
        unit = program.size_of_cost(
            self.trace.cost_through(numbers, *begun.halves), z, given, free
        )
        given[-1] = unit if 0.0 < unit < np.inf else st
        with self._lock:
            self._clock.begin(budget, (_PATIENT if patient else 1) * self._settings.iterations)
            solver = self._again if guess.multipliers else self._solver
            known = dict(zip(('lam_x0', 'lam_g0'), guess.multipliers, strict=False))
            found = solver(x0=z, p=given, lbx=lower, ubx=upper, lbg=least, ubg=most, **known)
            solved = unfinished or bool(solver.stats()['success'])
            self.broke_down = solver.stats()['return_status'] == 'Invalid_Number_Detected'
            if self._clock.iterations:  # else Ipopt did not begin, and its count is any number
                budget.evaluations += int(solver.stats()['iter_count'])
        z, *multipliers = (np.array(found[name]).ravel() for name in ('x', 'lam_x', 'lam_g'))
        if not (solved and np.isfinite(z).all()):
            return None
        states, middles, controls, last = program.split(z)
        solution = CollocatedMotion(
            _with_ends(states * sx, ends.states),
            middles * sx,
            _with_ends(controls * su, ends.controls),
            float(last[0, 0] * st),
            multipliers=tuple(multipliers),
        )
        cost = self.trace.cost_through(numbers, *solution.halves)
        size = program.size_of_cost(cost, z, given, free)
        return replace(solution, cost=cost, size=size) if np.isfinite(cost) else None


def _with_ends(values: Array, given: Array) -> Array:
    """Return a copy of the values, those at the ends replaced where they are given."""
    found = values.copy()
    found[[0, -1]] = np.where(np.isfinite(given), given, values[[0, -1]])
    return found


def _scales(values: Array, units: Sequence[str]) -> Array:
    """Return the sizes of columns, which may lie orders of magnitude apart."""
    sizes = np.abs(values).max(axis=0)
    alike = largest_of_unit(sizes, units)
    largest = np.where(alike > _NEARLY_ZERO, alike, sizes.max() + _NEARLY_ZERO)
    return np.asarray(np.maximum(sizes, _SCALE_SHARE * largest))

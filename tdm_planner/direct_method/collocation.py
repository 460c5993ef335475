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

from dataclasses import dataclass
import threading
import time
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from tdm_planner.arrays import Array
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.graphs import Call, Clock, Rounded
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.trajectory import to_nanoseconds

INNER = 0.25, 0.75  # where limits on states are kept beside an interval's ends and middle
_LEAST_SCALE = 1e-3, 1e-9  # of a state or control: share of the largest, and at least
_SMALL_LIMIT, _NO_LIMIT = 1e-2, 1e-13  # sizes along the guess between which limits are scaled
LIMITS_ROUNDING = 1e-6  # share of a limit's kinks: enough for a slope where something is at rest
_COST = 10.0  # what J is scaled to along the guess: a plan does not depend on the unit of J
_IPOPT: dict[str, Any] = {
    'print_level': 0,
    'sb': 'yes',
    'tol': 1e-5,
    'constr_viol_tol': 1e-7,
    'acceptable_iter': 0,
    'mu_strategy': 'monotone',
    'barrier_tol_factor': 30.0,  # how roughly the first barrier problems are solved
    'min_refinement_steps': 0,  # of a linear solution that is good as it is
    # The program is scaled; for its size a plain ordering is the quickest.
    'mumps_scaling': 0,
    'mumps_permuting_scaling': 0,
    'mumps_pivot_order': 0,
}
# From the solution of nearly the same program, with its multipliers.
_AGAIN = dict.fromkeys(('mu_init', 'warm_start_bound_push', 'warm_start_slack_bound_push'), 1e-6)


@dataclass(frozen=True)
class Settings:
    """
    How a program is solved: most `iterations` of Ipopt, its first barrier parameter `barrier`.

    `smoothing` is the share of J that is charged for the controls' changes: where they do not
    matter they rest. `rounding` is the share of what stands in a kink of the running cost, or of
    the rates, by which that is rounded, see `graphs.Rounded`.
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

    `duration` [s]; `cost` is its J. A solution near it on as many intervals begins with its
    `multipliers`, of the variables and of the rows.
    """

    states: Array
    middles: Array
    controls: Array
    duration: float
    cost: float = np.inf
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
    def finite(self) -> bool:
        """Whether all of it is made of numbers."""
        parts = self.states, self.middles, self.controls
        return all(bool(np.isfinite(part).all()) for part in parts) and self.duration > 0.0

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

    `complete` where they say all of it: a condition on a derivative that is neither a state nor a
    control cannot be kept by collocation. `regular` where `invert` gives numbers at both ends.
    """

    states: Array
    controls: Array
    complete: bool = True
    regular: bool = True

    @classmethod
    def of(cls, stated: CheckedFormulation) -> Ends:
        """
        Return what `invert` makes of the boundary values.

        A component is given if the free boundary values, varied at random, do not change it.
        """
        rng, states, controls = np.random.default_rng(1), [], []
        complete = regular = True
        for side, where in enumerate(('start', 'end')):
            y = {}
            for name, output in stated.outputs().items():
                given, scale = output.conditions(where), output.scale or 1.0
                y[name] = [
                    np.full(3, given[order]) if order in given else scale * rng.normal(size=3)
                    for order in range(output.derivatives + 1)
                ]
            z = {}
            for name, state in stated.integrated().items():
                value = state.start if side == 0 else state.end
                free = state.scale * rng.normal(size=3)
                z[name] = free if value is None else np.full(3, float(value))
            both = _inverted(stated, y, z)
            regular = regular and bool(np.isfinite(both).all())
            same = np.ptp(both, axis=0) <= 1e-9 * (1.0 + np.abs(both[0]))
            found = np.where(same, both[0], np.nan)
            first, last = np.split(found, [len(stated.state_names)])
            states.append(first)
            controls.append(last)
            for name, output in stated.outputs().items():
                for order in output.conditions(where):
                    moved = {key: list(jet) for key, jet in y.items()}
                    if order <= output.derivatives:
                        moved[name][order] = moved[name][order] + 0.1
                    kept = not np.array_equal(_inverted(stated, moved, z), both, equal_nan=True)
                    complete = complete and kept
        return cls(np.array(states), np.array(controls), complete, regular)


def _inverted(stated: CheckedFormulation, y: Any, z: Any) -> Array:
    """Return states and controls, (3, nx + nu)."""
    with np.errstate(all='ignore'):
        return np.hstack(stated.invert(y, z)).astype(float)


class Collocation:
    """
    The program of a traced statement on n `intervals`; made once a kind, for any numbers.

    `seconds` of processor time is what making it took: in proportion to the intervals;
    `has_kinks` whether the running cost or the rates have any, `has_alternatives` whether one of
    two limits will do somewhere.
    """

    def __init__(self, trace: Trace, intervals: int, settings: Settings) -> None:
        began = time.thread_time()
        self.trace, self.intervals, n = trace, intervals, intervals
        self._settings, self._lock = settings, threading.Lock()
        nx, nu = self._sizes = trace.rates.size1_in(0), trace.rates.size1_in(1)
        x_, m_ = ca.SX.sym('X', nx, n + 1), ca.SX.sym('M', nx, n)
        u_, t_ = ca.SX.sym('U', nu, n + 1), ca.SX.sym('T')
        sizes = trace.rates.size1_in(2), nx, nu, trace.unfolded.limit.size, 1, 1, 1
        p, sx, su, sl, st, charged, unit_j = (ca.SX.sym('s', size) for size in sizes)
        parts = trace.running, trace.rates, trace.unfolded.rows
        running, motion, stated = kinked = [Rounded(part) for part in parts]
        self.has_kinks = running.count + motion.count > 0
        self._either, self.has_alternatives = stated.either, bool(stated.either.any())
        self._limits = Call(trace.unfolded.rows, n + 1)
        self._rounded_limits = Call(stated.value, n + 1)
        self._kinks = [Call(one.sizes, n + 1) for one in kinked]
        e_running, e_motion, e_limits = (ca.SX.sym('e', one.count) for one in kinked)
        x, m = x_ * ca.repmat(sx, 1, n + 1), m_ * ca.repmat(sx, 1, n)
        u, duration = u_ * ca.repmat(su, 1, n + 1), t_ * st
        h, middle_u = duration / n, 0.5 * (u[:, :-1] + u[:, 1:])
        times = ca.DM(np.linspace(0.0, 1.0, n + 1)[None])

        def at(function: Any, *arguments: Any, rounding: Any = None) -> Any:
            count = arguments[0].shape[1]
            same = [p] if rounding is None else [p, rounding]
            return function.map(count)(*arguments, *(ca.repmat(one, 1, count) for one in same))

        rates = at(motion.value, x, u, rounding=e_motion)
        middle_rates = at(motion.value, m, middle_u, rounding=e_motion)
        a, b, fa, fb = x[:, :-1], x[:, 1:], rates[:, :-1], rates[:, 1:]
        unit = ca.repmat(1.0 / sx, 1, n)
        simpson = (b - a - h / 6 * (fa + 4 * middle_rates + fb)) * unit
        hermite = (m - 0.5 * (a + b) - h / 8 * (fa - fb)) * unit

        def kept(t: Any, x: Any, u: Any) -> Any:
            return at(stated.value, t, x, u, rounding=e_limits) / ca.repmat(sl, 1, t.shape[1])

        limits = kept(duration * times, x, u)
        self.inner_limits = np.flatnonzero(trace.between[trace.unfolded.limit])
        inner = []
        if self.inner_limits.size:
            for share in (0.5, *INNER):
                w0, w1 = (1 - share) ** 2 * (1 + 2 * share), share * (1 - share) ** 2
                w2, w3 = share**2 * (3 - 2 * share), share**2 * (share - 1)
                state = a * w0 + b * w2 + h * (w1 * fa + w3 * fb) if share != 0.5 else m
                control = (1 - share) * u[:, :-1] + share * u[:, 1:]
                instants = duration * (times[:, :-1] + share / n)
                inner.append(kept(instants, state, control)[self.inner_limits.tolist(), :])
        cost = trace.final(duration, x[:, -1], p)
        rounded = cost
        if trace.has_running_cost:

            def integral(function: Any, rounding: Any = None) -> Any:
                q = at(function, duration * times, x, u, rounding=rounding)
                halves = duration * (times[:, :-1] + 0.5 / n)
                qm = at(function, halves, m, middle_u, rounding=rounding)
                return h / 6 * ca.sum2(q[:, :-1] + 4 * qm + q[:, 1:])

            rounded = cost + integral(running.value, e_running)
            cost += integral(trace.running)
        ends = trace.start_conditions(0.0, x[:, 0], p), trace.end_conditions(duration, x[:, -1], p)
        conditions = ca.vertcat(*ends)
        rows = ca.vertcat(*map(ca.vec, (simpson, hermite, conditions, limits, *inner)))
        z = ca.vertcat(ca.vec(x_), ca.vec(m_), ca.vec(u_), t_)
        given = ca.vertcat(p, sx, su, sl, e_running, e_motion, e_limits, st, charged, unit_j)
        self._equalities = 2 * n * nx + conditions.numel()
        smoothed = _COST * (rounded / unit_j + charged * ca.sumsqr(u_[:, 1:] - u_[:, :-1]))
        self._cost = ca.Function('cost', [z, given], [cost])
        ipopt = _IPOPT | {'max_iter': settings.iterations, 'mu_init': settings.barrier}
        # From near a solution the limits' multipliers begin where the barrier has them.
        ipopt['bound_mult_init_method'] = 'constant' if settings is COLD else 'mu-based'
        self._clock = Clock(z.numel(), rows.numel(), given.numel())
        program: dict[str, Any] = {'x': z, 'f': smoothed, 'g': rows, 'p': given}
        options: dict[str, Any] = {
            'print_time': 0,
            'show_eval_warnings': False,
            'calc_lam_p': False,
            'no_nlp_grad': True,
            'detect_simple_bounds': True,  # a limit on one variable takes no row
            'iteration_callback': self._clock,
        }
        self._solver = ca.nlpsol('collocation', 'ipopt', program, {**options, 'ipopt': ipopt})
        made = {'grad_f': 'nlp_grad_f', 'jac_g': 'nlp_jac_g', 'hess_lag': 'nlp_hess_l'}
        options |= {name: self._solver.get_function(of) for name, of in made.items()}
        options['ipopt'] = ipopt | _AGAIN | {'warm_start_init_point': 'yes'}
        self._again = ca.nlpsol('again', 'ipopt', program, options)
        self.seconds = time.thread_time() - began

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
        unfinished: bool = False,
        alternatives: float = LIMITS_ROUNDING,
    ) -> CollocatedMotion | None:
        """
        Return the optimum near `guess`; None if Ipopt does not converge, unless `unfinished` does.

        `durations` are the shortest and the longest [s]; `kept` (n + 1, nm) is what must be left
        to every limit at the nodes, and between them. `roughly`: with kinks as round as at first.
        `alternatives` is the share by which those between two limits of which one will do are.
        """
        n, (nx, nu) = self.intervals, self._sizes
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
            kinks = [by * v + _LEAST_SCALE[1] for by, v in zip(shares, largest, strict=True)]
            lost = np.nan_to_num(rows - self._rounded_limits(*along, kinks[2])[0])
        sl = np.abs(np.nan_to_num(rows, posinf=0.0, neginf=0.0)).max(axis=0)
        sl[(sl > _SMALL_LIMIT) | (sl < _NO_LIMIT)] = 1.0  # Ipopt itself scales what is large
        kept = kept[:, self.trace.unfolded.limit] / sl
        # What is given may be on a limit, or in its kink, but for rounding.
        kept[[0, -1]] -= _IPOPT['constr_viol_tol'] + np.maximum(lost[[0, -1]], 0.0) / sl
        sx, su, st = _scales(states), _scales(controls), guess.duration
        parts = states / sx, guess.middles / sx, controls / su
        z = np.concatenate([*map(np.ravel, parts), [1.0]])
        fixed = [np.full(part.shape, np.nan) for part in parts]
        fixed[0][[0, -1]], fixed[2][[0, -1]] = ends.states / sx, ends.controls / su
        pinned = np.append(np.concatenate([*map(np.ravel, fixed)]), np.nan)
        lower, upper = (np.where(np.isnan(pinned), far, pinned) for far in (-np.inf, np.inf))
        lower[-1], upper[-1] = durations[0] / st, durations[1] / st
        z = np.clip(z, lower, upper)
        inner = kept[:, self.inner_limits]
        between = [((1 - w) * inner[:-1] + w * inner[1:]).ravel() for w in (0.5, *INNER)]
        least = np.concatenate([np.zeros(self._equalities), kept.ravel(), *between])
        most = np.where(np.arange(least.size) < self._equalities, 0.0, np.inf)
        given = np.concatenate([numbers, sx, su, sl, *kinks, [st, charge.smoothing, 1.0]])
        with self._lock:
            size = abs(float(self._cost(z, given)))
            given[-1] = size if 1e-9 < size < 1e9 else st
            self._clock.begin(budget)
            solver = self._again if guess.multipliers else self._solver
            known = dict(zip(('lam_x0', 'lam_g0'), guess.multipliers, strict=False))
            found = solver(x0=z, p=given, lbx=lower, ubx=upper, lbg=least, ubg=most, **known)
            solved = unfinished or bool(solver.stats()['success'])
            budget.evaluations += int(solver.stats()['iter_count'])
            cost = float(self._cost(found['x'], given))
        z, *multipliers = (np.array(found[name]).ravel() for name in ('x', 'lam_x', 'lam_g'))
        states, middles, controls, last = np.split(z, [nx * (n + 1), (2 * n + 1) * nx, z.size - 1])
        if not (solved and np.isfinite(z).all() and np.isfinite(cost)):
            return None
        states = _with_ends(states.reshape(n + 1, nx) * sx, ends.states)
        controls = _with_ends(controls.reshape(n + 1, nu) * su, ends.controls)
        middles, duration = middles.reshape(n, nx) * sx, float(last[0] * st)
        return CollocatedMotion(states, middles, controls, duration, cost, tuple(multipliers))


def _with_ends(values: Array, given: Array) -> Array:
    """Return a copy of the values, those at the ends replaced where they are given."""
    found = values.copy()
    found[[0, -1]] = np.where(np.isfinite(given), given, values[[0, -1]])
    return found


def _scales(values: Array) -> Array:
    """Return the sizes of columns."""
    share, least = _LEAST_SCALE
    sizes = np.abs(values).max(axis=0)
    return np.asarray(np.maximum(sizes, share * sizes.max() + least))

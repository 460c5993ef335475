# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The plant of a stated problem: its equations, traced, and motions corrected by their slopes."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import trapezoid
from tdm_planner.arrays import Array, exponentials, largest_of_unit, Mask
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import CollocatedMotion, Ends
from tdm_planner.direct_method.formulation import Formulation
from tdm_planner.direct_method.graphs import breaks_of, Call, Rounded
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.exceptions import DeadlineExceeded, NotFinite
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import ReplayedMotion, Trajectory
from tdm_planner.verification import crossed, resolved

_REST = 1e-9  # by which kinks of the rates are rounded for their slopes
# Violation of a limit that is allowed: clip(1e-5, 1e-6 size, 1e-4 size) + 1e-14, in its unit.
_ALLOWED = 1e-5, 1e-6, 1e-4, 1e-14
_RATES_ROUNDING = 1e-7  # share by which traced rates may differ from numpy's along a plan
_PACE = 1e-2  # share of the duration that counts as much as what is left to a control
END_TOLERANCE = 1e-3  # of the conditions that are stated at the ends
_FAR = 0.5  # units of room that controls may use up while the duration stays
_FOLLOWED = 1e9  # by which deviations may grow where a replay is sure to follow a motion
_INSIDE = 64  # parts of an interval in which the rates have a kink or jump
_LEAST, _TINY = 1e-5, 1e-12  # share of a control that is left where nothing is; at least


class DirectPlant:
    """
    The plant of a formulation, as its `derivative` says: by the trace where it is quick.

    `agrees` compares the trace with the statement along a whole plan.
    """

    def __init__(self, formulation: Formulation) -> None:
        self.stated = CheckedFormulation(formulation)
        self.state_names, self.state_units = formulation.state_names, formulation.state_units
        self.control_names = formulation.control_names
        self.control_units = formulation.control_units
        self.trace = Trace.of(self.stated)
        self.numbers = self.trace.values(formulation)
        self._one, self._one_margin = Call(self.trace.rates), Call(self.trace.margins)
        self._one_slope = dict[Any, Call]()  # by function, and arguments

    def derivative(self, state: Array, control: Array) -> Array:
        """
        Time derivative of the states: (..., nx), (..., nu) -> (..., nx); of many by numpy.

        Raise NotFinite naming the state, if a rate is not a finite number.
        """
        if state.ndim == 1:
            rates: Array = self._one(state, control, self.numbers)[0].copy()
            if np.isfinite(rates).all():
                return rates
        stacked = self.stated.derivative(state, control)
        if not np.isfinite(stacked).all():
            index = np.unravel_index(int(np.argmin(np.isfinite(stacked))), stacked.shape)
            raise NotFinite(
                f"derivative gives the rate of '{self.state_names[index[-1]]}' = {stacked[index]} "
                f'in state {state[index[:-1]]} under control {control[index[:-1]]}'
            )
        return stacked

    def replay(self, trajectory: Trajectory, until: Budget | None = None) -> ReplayedMotion:
        """
        Integrate along the planned controls.

        Raise DeadlineExceeded if the time of `until` is up, NotFinite where it cannot go on.
        """
        given = trajectory.control_pieces, trajectory.states[0], self.numbers
        motion = self.trace.integrator(*given, until)
        if motion is None and until is not None and until.spent:
            raise DeadlineExceeded(f'its replay took longer than {until.seconds:.3g} s')
        if motion is None:
            raise NotFinite('its motion is not finite everywhere, or too fast to be replayed')
        return motion

    @cached_property
    def ends(self) -> Ends:
        """What is given at both ends."""
        return Ends.of(self.stated)

    @cached_property
    def kept_at_ends(self) -> Array:
        """What is kept of every limit at both ends, (2, nm); where all is given, what is left."""
        ends, duration, given = self.ends, self.stated.duration(), self.trace.margin_names
        states, controls = np.nan_to_num(ends.states), np.nan_to_num(ends.controls)
        left = self.limits(np.array([0.0, duration.guess]), states, controls)
        opens = ends.opens(self.trace.uses, duration)
        return np.where(opens, self.stated.reserves(given), np.fmin(left, 0.0))

    @property
    def control_range(self) -> Array:
        """Lowest and highest controls, (2, nu); infinite where they are not limited."""
        limits = self.stated.control_limits
        return np.array([limits.get(k, (-np.inf, np.inf)) for k in self.control_names]).T

    @cached_property
    def obstacles(self) -> Mask:
        """Which limits (nm,) are obstacles: they may be violated between states that keep them."""
        return self.trace.obstacles(self.numbers)

    @cached_property
    def durations(self) -> tuple[float, float]:
        """Shortest and longest duration [s], the same where it is fixed."""
        given = self.stated.duration()
        return (given.guess, given.guess) if given.fixed else given.bounds

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (..., nx, nx) and df/du (..., nx, nu), at one state or at many (N, ..)."""
        rates, nx = self.trace.rates, state.shape[-1]

        def smooth() -> Any:
            rounded, given = Rounded(rates), rates.sx_in()
            radius = np.full(rounded.count, _REST)
            return ca.Function('smooth_rates', given, [rounded.value(*given, radius)])

        # Drag such as v sqrt(vx^2 + vy^2) has a slope at rest, too.
        smooth_rates = self.trace.once('smooth_rates', smooth)
        _, slopes = self._with_slopes(smooth_rates, (0, 1), state, control)
        return slopes[..., :nx], slopes[..., nx:]

    def _with_slopes(
        self, function: Any, by: tuple[int, ...], *given: Array | float
    ) -> tuple[Array, Array]:
        """
        Return the values (..., m) of a traced function, and slopes (..., m, n) `by` some.

        All that is `given` is of one place, or of many; one thread at a time.
        """

        def make() -> Any:
            arguments = function.sx_in()
            found = ca.densify(function(*arguments))
            slopes = ca.densify(ca.jacobian(found, ca.vertcat(*(arguments[i] for i in by))))
            return ca.Function('slopes', arguments, [found, ca.vec(slopes)])

        last, key = np.asarray(given[-1]), (function.name(), by)
        many = last.ndim > 1
        if not many and key not in self._one_slope:
            self._one_slope[key] = Call(self.trace.once(key, make))
        call = Call(self.trace.once(key, make), len(last)) if many else self._one_slope[key]
        values, slopes = call(*given, self.numbers)
        size = sum(function.size1_in(i) for i in by)
        each = slopes.reshape(*values.shape[:-1], size, values.shape[-1])
        return values.copy(), np.swapaxes(each, -1, -2).copy()

    def control_margins(self, time: float, state: Array, control: Array) -> Array:
        """Return what is left to the limits in which the controls have a part, (nm,)."""
        margins = self._one_margin(time, state, control, self.numbers)[0]
        found: Array = margins[self.trace.of_controls]
        return found

    def linear_limits(
        self, times: Array, states: Array, controls: Array
    ) -> tuple[Array, Array, Array]:
        """Return what is left to the limits at N instants (N, nm), and its slopes (N, nm, n)."""
        given, nx = (times[:, None], states, controls), states.shape[1]
        left, slopes = self._with_slopes(self.trace.margins, (1, 2), *given)
        return left, slopes[..., :nx], slopes[..., nx:]

    def end_conditions(self, time: float, state: Array) -> tuple[Array, Array]:
        """Return the conditions at the end (m,); their slopes by state and time (m, nx + 1)."""
        return self._with_slopes(self.trace.end_conditions, (1, 0), time, state)

    def limit_tolerances(self, plan: Trajectory | CollocatedMotion) -> Array:
        """
        Return by how much a plan may violate every limit, (nm,).

        Whoever states a thrust in micronewtons or a height in kilometres gets as true a plan: the
        size of a limit is that for the largest range of the states of a unit.
        """
        alike = largest_of_unit(np.ptp(plan.states, axis=0), self.state_units)
        sizes = self.limit_sizes(plan, alike, np.abs(plan.controls).max(axis=0))
        usual, least, most, rounding = _ALLOWED
        return np.asarray(np.clip(usual, least * sizes, most * sizes) + rounding)

    def limit_sizes(
        self, plan: Trajectory | CollocatedMotion, states: Array, controls: Array
    ) -> Array:
        """
        Return what every limit changes by, where it is least, for such changes: (nm,).

        They are those of `states` (nx,) and `controls` (nu,). Its own values are no measure: they
        may have a pole elsewhere, or be 0 throughout. It is 1 where nothing changes a limit.
        """
        left, by_state, by_control = self.linear_limits(plan.times, plan.states, plan.controls)
        at = np.argmin(np.nan_to_num(left, nan=np.inf), axis=0), np.arange(left.shape[1])
        changes = np.nan_to_num(np.hstack([by_state[at], by_control[at]]), posinf=0.0, neginf=0.0)
        sizes: Array = np.abs(changes) @ np.concatenate([states, controls])
        sizes[sizes == 0.0] = 1.0
        return sizes

    def violated(self, plan: Solution) -> dict[str, float]:
        """Return by how much a plan violates the limits that its check found violated."""
        worst, allowed = plan.verification.worst, self.limit_tolerances(plan.trajectory)
        named = zip(self.trace.margin_names, allowed, strict=True)
        return {name: -worst[name] for name, most in named if worst[name] < -most}

    @np.errstate(all='ignore')
    def instability(self, plan: Trajectory) -> str:
        """Tell where deviations grow so much along a plan that no replay follows it, or ''."""
        a, _ = self.jacobians(plan.states[1:], plan.controls[1:])
        # From every sample to the end; states count in their ranges.
        steps = exponentials(np.nan_to_num(a) * np.diff(plan.times)[:, None, None])
        onwards = accumulate(steps[::-1], np.matmul)
        sizes = np.ptp(plan.states, axis=0) + _TINY
        growth = max(float(np.abs(phi * sizes / sizes[:, None]).max()) for phi in onwards)
        return (
            f'; the plant is unstable: deviations from the plan grow {growth:.0e}-fold, and its '
            'controls are given in advance: shorten the motion, or state a feedback in the plant'
            if growth > _FOLLOWED
            else ''
        )

    def rates(self, states: Array, controls: Array) -> Array:
        """Return the rates of states (N, nx) by the trace, NaN where they are no numbers."""
        return Call(self.trace.rates, len(states))(states, controls, self.numbers)[0]

    def limits(self, times: Array, states: Array, controls: Array) -> Array:
        """Return what is left to the limits at N instants, (N, nm), by the trace."""
        call = Call(self.trace.margins, len(times))
        return call(times[:, None], states, controls, self.numbers)[0]

    def breaks(self, times: Array, states: Array, controls: Array) -> Array:
        """Return what changes its sign where a limit has a kink or jumps, at N instants (N, k)."""
        found = self.trace.once('breaks', lambda: breaks_of(self.trace.margins))
        return Call(found, len(states))(times[:, None], states, controls, self.numbers)[0]

    def cost_of(self, plan: Trajectory, replayed: ReplayedMotion) -> float:
        """Return J of a plan as it was replayed."""
        knots = np.union1d(plan.times, replayed.steps)
        times = np.insert(knots, np.arange(1, knots.size), 0.5 * (knots[1:] + knots[:-1]))
        states, controls = replayed.states(times), plan.controls_at(times)
        return self.trace.cost_through(self.numbers, times, states, controls)

    def mistaken(self, plan: Trajectory, replayed: ReplayedMotion, tolerance: Array) -> str:
        """Tell why a replay by the traced rates may not be the motion of the plant, or ''."""
        if not self.agrees(plan.states, plan.controls):
            return 'derivative gives other rates when it is traced than with numpy'
        found = self.trace.once('rates_break', lambda: breaks_of(self.trace.rates))
        times, states = resolved(replayed, plan, ())
        controls = plan.controls_at(times)
        places = crossed(Call(found, len(times))(states, controls, self.numbers)[0])
        if not places.size:
            return ''
        steps, at = np.diff(times)[places, None], np.linspace(0.0, 1.0, _INSIDE + 1)
        within = (times[places, None] + steps * at).ravel()
        rates = self.rates(replayed.states(within), plan.controls_at(within))
        flown = steps * trapezoid(rates.reshape(-1, at.size, states.shape[1]), at, axis=1)
        missed = np.abs(np.diff(states, axis=0)[places] - flown)
        if (missed.sum(axis=0) <= tolerance).all():
            return ''
        when = times[places[np.argmax((missed / tolerance).max(axis=1))]]
        return f'derivative changes at t = {when:.3f} s within a step of the replay'

    def agrees(self, states: Array, controls: Array) -> bool:
        """Whether the trace gives what numpy gives at states (N, nx) and controls (N, nu)."""
        stated = self.stated.derivative(states, controls)
        traced = self.rates(states, controls)
        size = 1.0 + np.abs(stated).max(axis=0)
        return bool((np.abs(stated - traced) <= _RATES_ROUNDING * size).all())


@np.errstate(all='ignore')
def corrected(
    plant: DirectPlant,
    motion: CollocatedMotion,
    ends: Ends,
    durations: tuple[float, float],
    tolerance: Array,
) -> CollocatedMotion | None:
    """
    Return a collocated motion that whoever integrates its controls ends at the goal with.

    Collocation leaves a small defect d_k in every interval: the plant, integrated from node k,
    misses node k + 1. Where it is unstable the defects grow exponentially until the end. A step
    of Newton's method in the sense of multiple shooting removes them, to first order. With the
    plant linearised in every interval,

        dx_(k+1) = Phi_k dx_k + d_k + B_k du,    dx_0 = 0,    dx_n = 0 where the end is given,

    it takes the least change du of controls and duration, in units of what is left to the limits;
    None where these are in the way. As every interval is linearised about its own nodes, it
    converges however unstable the plant is. See Bock and Plitt, *A multiple shooting algorithm
    for direct solution of optimal control problems*, 1984.

    The conditions that are stated at the end are kept in the same way. `durations` are the
    shortest and the longest [s]; `tolerance` (nx,) is the unit of errors at the end. Raises
    numpy's LinAlgError where the limits' slopes are out of all proportion.
    """
    x, u, m = motion.states, motion.controls, motion.middles
    n, nx, nu = motion.intervals, x.shape[1], u.shape[1]
    h, middle_u = np.diff(motion.times)[:, None, None], 0.5 * (u[:-1] + u[1:])

    def mean(at_ends: Array, in_middles: Array) -> Array:
        return (at_ends[:-1] + 4.0 * in_middles + at_ends[1:]) / 6.0

    # The state, controls, their rates, and a disturbance that lasts: by the first term of Magnus.
    nw = nx + nu  # of states and controls
    system = np.zeros((n, nw + nu + 1, nw + nu + 1))
    slopes_of = zip(plant.jacobians(x, u), plant.jacobians(m, middle_u), strict=True)
    system[:, :nx, :nx], system[:, :nx, nx:nw] = (mean(*pair) for pair in slopes_of)
    system[:, :nx, -1] = mean(plant.rates(x, u), plant.rates(m, middle_u))
    system[:, nx:nw, nw:-1] = np.eye(nu)
    system = np.nan_to_num(system * h, posinf=0.0, neginf=0.0)  # 0 / 0 at rest
    grown = exponentials(system)[:, :nx]
    transition, by_last = grown[..., :nx], grown[..., nw:-1] / h
    by_first = grown[..., nx:nw] - by_last
    by_duration = grown[..., -1:] / motion.duration
    steps = x[:-1], u[:-1], u[1:], h[:, 0]
    defects = plant.trace.integrator.stepped(*steps, plant.numbers) - x[1:]

    # Slopes of the end by every control and by the duration, and what the end is missed by.
    of_controls, of_duration = np.zeros((nx, n + 1, nu)), np.zeros((nx, 1))
    miss, rest = np.zeros(nx), np.eye(nx)
    for k in reversed(range(n)):
        of_controls[:, k] += rest @ by_first[k]
        of_controls[:, k + 1] += rest @ by_last[k]
        of_duration += rest @ by_duration[k]
        miss += rest @ defects[k]
        rest = rest @ transition[k]

    left, _, by_control = plant.linear_limits(motion.times, x, u)
    room = _room(left, by_control, np.abs(u).max(axis=0))
    for side in (0, -1):
        room[side, np.isfinite(ends.controls[side])] = 0.0
    shortest, longest = durations
    pace = min(_PACE * motion.duration, motion.duration - shortest, longest - motion.duration)
    of_room = (of_controls[:, :, None] @ room).reshape(nx, -1)
    slopes = np.hstack([of_room, pace * of_duration])
    given = np.isfinite(ends.states[1])
    values, of_state = plant.end_conditions(motion.duration, x[-1])
    of_end, of_time = of_state[:, :-1], np.zeros((values.size, slopes.shape[1]))
    of_time[:, -1] = pace * of_state[:, -1]
    missed = np.append(
        ((ends.states[1] - x[-1] - miss) / tolerance)[given],
        -(values + of_end @ miss) / END_TOLERANCE,
    )
    rows = np.vstack(
        [(slopes / tolerance[:, None])[given], (of_end @ slopes + of_time) / END_TOLERANCE]
    )
    if not (np.isfinite(rows).all() and np.isfinite(missed).all()):
        return None
    # Another duration moves all instants, by up to a nanosecond: only where it must be.
    change = np.append(np.linalg.lstsq(rows[:, :-1], missed, rcond=None)[0], 0.0)
    if np.linalg.norm(change) > _FAR:
        change = np.linalg.lstsq(rows, missed, rcond=None)[0]
    if np.linalg.norm(change) > 1.0:
        return None
    du, longer = (room @ change[:-1].reshape(n + 1, nu, 1))[..., 0], pace * float(change[-1])
    moved = np.zeros_like(x)
    for k in range(n):
        moved[k + 1] = transition[k] @ moved[k] + defects[k] + by_duration[k, :, 0] * longer
        moved[k + 1] += by_first[k] @ du[k] + by_last[k] @ du[k + 1]
    middles = m + 0.5 * (moved[:-1] + moved[1:])
    duration = motion.duration + longer
    return replace(motion, states=x + moved, middles=middles, controls=u + du, duration=duration)


def _room(margins: Array, slopes: Array, sizes: Array) -> Array:
    """
    Return the changes of controls (N, nu, nu) that are one unit, column by column.

    With margins (N, nm), their slopes by the controls (N, nm, nu) and the controls' `sizes` (nu,)
    they are the axes of Dikin's ellipsoid, within which limits are kept.
    """
    sizes = sizes + _TINY
    slopes = np.nan_to_num(slopes * sizes, posinf=0.0, neginf=0.0)
    left = np.maximum(np.nan_to_num(margins), _LEAST * np.linalg.norm(slopes, axis=2) + _TINY)
    scaled = slopes / left[..., None]
    axes = np.linalg.cholesky(np.eye(sizes.size) + np.swapaxes(scaled, 1, 2) @ scaled)
    return np.asarray(sizes[:, None] * np.swapaxes(np.linalg.inv(axes), 1, 2))

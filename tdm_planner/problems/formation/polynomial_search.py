# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The search for formations' plans by polynomials of the virtual arc: program, guesses, minima."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache, partial
import itertools
import math
from typing import TypeAlias

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.bases import PolynomialBasis
from tdm_planner.direct_method.formulation import PowerProducts
from tdm_planner.direct_method.trust_region import Minimum, TrustRegionOptions
from tdm_planner.problems.formation import polynomial_kernels
from tdm_planner.problems.formation.polynomial_plan import trajectory
from tdm_planner.problems.formation.program import FormationProgram
from tdm_planner.problems.formation.reference_motion import (
    acceleration,
    end_derivatives,
    grid_of,
    MotionForm,
)
from tdm_planner.problems.formation.search import (
    FormationSearch,
    INSTANTS,
    kept_motions,
    screened,
)
from tdm_planner.problems.formation.task import first_arrival, FormationTask, least_time
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Polynomials: TypeAlias = Minimum['PolynomialProgram']

_USED = 0.67  # of F_max, assumed by an initial guess: polynomials seldom give more
_YAW_SCALE = 10.0
_NODES = 24  # of the quadrature of a fit
_ENDED = 0.02  # of the longest motion that is left: robots with less have arrived
_BOWS = np.array([0.1, -0.1, 0.22, -0.22])
_LONGER = 0.75  # what a bow costs, in separations
_WANTED = 0.98  # clearances wanted of a guess: minimising gains what is left
_TOO_NEAR = 3.0  # price of a metre by which robots come too near
_TURNING_SHARE = 0.95  # of the thruster's rate, at which it turns before a manoeuvre
_WEAK_THRUST = 0.1  # of F_max: a manoeuvre may begin with less thrust in a wrong direction
_ALIGNED = 0.1  # [rad] less than this the thruster turns on the way
_MANY = 12  # robots from which on violations are charged more
_RADIUS, _REFINING_RADIUS = 0.15, 0.05
_GUESS_ROUNDS = 4  # before giving up
_RAISE, _HIGHEST = 4, 15  # by which the order is raised where the rest of a plan did not do
_WORSE = 1.1  # times the best cost so far: a start that is nearly feasible there is aborted
_ITERATIONS, _WARM_ITERATIONS = 60, 30
_NEARLY = 4.0  # times the accuracy of the end aimed at
_OF_PROGRAM = ('low', 'high', 'clearances', 'centres', 'interval', 'kept', 'varied')


class PolynomialProgram(FormationProgram):
    """
    The program of one manoeuvre by reference motions of a `form`.

    The varied parameters x (n, P) of one robot are b (q + 1) s, q of x (nf), of y (nf), of yaw
    (ny). Staying robots have only their times (and attitudes) varied. `held` (n, P) holds the
    parameters of robots whose motion is not varied but avoided by the others, NaN for those of
    the others.
    """

    kernels = polynomial_kernels
    curvature = 1e-6, 1e-3

    def __init__(self, task: FormationTask, form: MotionForm, held: Array | None = None) -> None:
        self.form, grid = form, grid_of(form)
        self.basis, self._free = end_derivatives(form.order, form.vary_ends)
        self.nb, number = form.degree + 1, np.arange(grid.shapes.shape[2])
        self.yaws = slice(self.nb + 2 * self._free.shape[1], None)  # parameters of the yaw
        self.held = np.full((task.n, number.size), np.nan) if held is None else held
        way = np.linalg.norm(task.goal - task.departure, axis=1)
        speed = float(np.linalg.norm(task.velocity, axis=1).max())
        longest = max(float(way.max()), task.separation)
        self.time = max(2.4 * math.sqrt(longest / task.thrust), speed / task.thrust)
        units = np.full(number.size, 10.0 * longest)
        units[: self.nb], units[self.yaws] = self.time, _YAW_SCALE
        turn = least_time(task.goal_yaw - task.departure_yaw, task.yaw_rate, task.torque)
        super().__init__(
            task,
            first_arrival(task, turn, _USED * task.thrust),
            np.tile(units, (task.n, 1)),
            np.where(number < self.nb, 1.0 / self.nb, 0.0),
            (number < self.nb) | (number >= self.yaws.start),
            ~np.isnan(self.held[:, 0]),
        )
        self._set_bounds()
        self.limits = {
            "limits.thrust of '{}'": grid.weights.size,
            "limits.torque of '{}'": grid.weights.size,
            "the distance of '{}' from the walls": 4 * len(grid.places),
        }
        fixed = np.zeros((task.n, *grid.shapes.shape[:2]))
        fixed[..., 0] = np.column_stack([task.departure, task.departure_yaw])
        fixed[:, :2, (form.order + 1) // 2] = task.goal
        fixed[:, 2, (form.yaw_order + 1) // 2] = task.goal_yaw
        self.manoeuvre = polynomial_kernels.Manoeuvre(
            grid=grid,
            fixed=fixed,
            velocity=np.column_stack([task.velocity, task.yaw_rate]),
            acceleration=np.column_stack([task.acceleration, task.yaw_acceleration]),
            coast=np.ascontiguousarray(task.coast),
            thrust=float(task.thrust),
            torque=float(task.torque),
            separation=float(task.separation),
            **{name: getattr(self, name) for name in _OF_PROGRAM},
        )

    def _set_bounds(self) -> None:
        task, nb = self.task, self.nb
        lower, upper = (np.full(self.units.shape, sign * np.inf) for sign in (-1.0, 1.0))
        # The speed factor's coefficients must stay positive, and well so.
        lower[:, :nb] = max((0.05 if nb == 1 else 0.4) * self.time, task.shortest)
        lower[task.staying, :nb] = 0.02 * self.time
        upper[:, :nb] = np.maximum(task.longest - task.coast, 0.1)[:, None]
        upper[task.staying & (task.arrived > 0.0), :nb] = 0.03 * self.time  # there already
        lower = np.minimum(lower, 0.9 * upper)
        self.bound(lower, upper, np.nan_to_num(self.held))

    def with_task(self, task: FormationTask) -> PolynomialProgram:
        """Return the program of another manoeuvre by the same reference functions."""
        return PolynomialProgram(task, self.form, self.held)

    def fit(self, b: Array, bend: Callable[[Array], Array]) -> Array:
        """
        Varied parameters (n, P) of rates b (n, q + 1) s whose motions bend most as wanted.

        `bend` gives the second derivatives (n, 2, K) at arcs s (K,). The yaw is at rest.
        """
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        s = (nodes + 1) / 2
        x = np.zeros(self.units.shape)
        x[:, : self.nb] = b
        curvature = self.basis.values(s, 2)
        missed = (bend(s) - self.positions(x) @ curvature.T) * (weights / 2)
        first, last = self.nb, self.yaws.start
        x[:, first:last] = (missed @ (curvature @ self._free)).reshape(len(b), -1)
        return x

    def positions(self, x: Array) -> Array:
        """End derivatives (n, 2, order + 1) of x and y."""
        return polynomial_kernels.unpacked(self.manoeuvre, x)[:, :2, : self.form.order + 1]

    def warm_guess(self, rest: Mapping[str, Trajectory]) -> Array:
        """
        Varied parameters (n, P) that bend as the `rest` of a plan does.

        Robots whose motion has ended take the usual durations, and go straight.
        """
        plans = [rest[name] for name in self.task.names]
        durations = np.array([plan.duration for plan in plans])
        ended = durations < _ENDED * durations.max()
        durations[ended] = self.usual_durations()[ended]

        def bend(s: Array) -> Array:
            found = np.zeros((len(plans), 2, s.size))
            for i, plan in enumerate(plans):
                state, control = plan.sample(plan.times[0] + plan.duration * s)
                heading = state[:, 4] + state[:, 6]
                push = control[:, 0] / self.task.plant.mass * durations[i] ** 2
                found[i] = push * np.stack([np.cos(heading), np.sin(heading)])
            return found

        x = self.fit(np.repeat(durations[:, None], self.nb, axis=1), bend)
        x[ended] *= np.arange(self.size) < self.nb
        return x


class PolynomialSearch(FormationSearch[Polynomials]):
    """
    Local minima of one manoeuvre from several initial guesses, and their plans.

    Of a `previous` plan the remaining motion is the initial guess, with polynomials of higher
    order where those of the form do not do, and then one new guess after the other.
    """

    def prepared(self) -> list[Callable[[], Iterable[Polynomials]]]:
        """Return what makes the candidates of each round."""
        settings = self.settings
        self.form = form = MotionForm(
            settings.polynomial_order,
            settings.yaw_order,
            settings.speed_factor_order,
            settings.end_accelerations == 'varied',
            settings.nodes,
        )
        higher = form._replace(order=min(form.order + _RAISE, _HIGHEST), nodes=None)
        self._guesses = lru_cache(maxsize=1)(self._begun)  # go on in the next round
        self._options = TrustRegionOptions(
            penalties=(3.0 if self.task.n >= _MANY else 1.0,),
            feasibility=(self.feasible,),
            radius=_RADIUS,
            iterations=_ITERATIONS,
        )
        self._refining = self._options._replace(radius=_REFINING_RADIUS)
        # A plan that is to replace another on the way, and may be replaced, must be there soon.
        self._enough = _NEARLY if self.rest else 1.0
        resumed = [partial(self._resumed, each) for each in (form, higher)] if self.rest else []
        self.starts = 1 if self.rest else self.starts
        return [*resumed, *[self._minima] * _GUESS_ROUNDS]

    def _begun(self, task: FormationTask) -> tuple[PolynomialProgram, Iterator[Array]]:
        program = PolynomialProgram(task, self.form)
        return program, guesses(program, self.rng)

    def _minima(self) -> Iterator[Polynomials]:
        """Yield minima from further guesses; then with more distance kept."""
        program, further = self._guesses(self.task)
        first = map(program.reduce, itertools.islice(further, self.starts))
        return self._completed(self.minima(program, first, self._options, _WORSE))

    def _resumed(self, form: MotionForm) -> Iterator[Polynomials]:
        """
        Yield the minimum that the remaining motion of a plan leads to.

        Robots about to arrive keep theirs.
        """
        program = PolynomialProgram(self.task, form)
        x = program.warm_guess(self.rest)
        coast = self._needed_coast(program, x)
        self.kept = kept_motions(self.task, self.rest)
        kept = np.array([name in self.kept for name in self.task.names])
        task = replace(self.task, coast=np.where(kept, 0.0, 1.03 * coast))
        program = PolynomialProgram(task, form, np.where(kept[:, None], x, np.nan))
        options = self._options._replace(iterations=_WARM_ITERATIONS)
        return self._completed(self.minimised(program, program.reduce(x), options))

    def _completed(self, found: Iterable[Polynomials]) -> Iterator[Polynomials]:
        """Yield minima with thrusters turned first; then with more distance kept."""
        turned = []
        for candidate in found:
            turned.append(self._turned(candidate) or candidate)
            yield turned[-1]
        for candidate in turned:
            yield from self._apart(candidate)

    @staticmethod
    def _needed_coast(program: PolynomialProgram, x: Array) -> Array:
        """
        Time [s] that every thruster needs to turn before the motion at x (n, P) begins (n,).

        Zero where the thruster's angle is free, the robot stays, or the motion begins with so
        little thrust that the thruster can turn on the way.
        """
        task, ends = program.task, program.positions(x)
        slope = x[:, : program.nb] @ program.manoeuvre.grid.slope
        begun = acceleration(x[:, :1], slope[:, None], ends[..., 1], ends[..., 2])
        away = np.arctan2(begun[:, 1], begun[:, 0]) - task.departure_yaw - task.alpha
        angle = np.abs(np.angle(np.exp(1j * np.nan_to_num(away))))
        weak = np.linalg.norm(begun, axis=1) < _WEAK_THRUST * task.thrust
        needed = angle / (_TURNING_SHARE * task.thruster_rate) + 0.01 * program.durations(x)
        idle = task.staying | weak | np.isnan(task.alpha) | (angle <= _ALIGNED)
        return np.where(idle, 0.0, needed)

    def plans(self, candidate: Polynomials) -> Iterator[Solution]:
        """Yield the plan of a candidate."""
        yield self.assessed(self.motions(candidate), candidate.point.xi)

    def motions(self, candidate: Polynomials) -> dict[str, Trajectory]:
        """Return the motions that inverse dynamics make of a candidate, but for those kept."""
        program, how = candidate.program, (self.budget, self._enough)
        return {
            name: trajectory(program.task, program.form, candidate.point.cache, i, *how)
            for i, name in enumerate(self.task.names)
            if name not in self.kept
        }

    def _apart(self, candidate: Polynomials) -> list[Polynomials]:
        """Minimise on, keeping more distance: a slow thruster leads robots off their motions."""
        program = candidate.program.with_task(self.farther(candidate.program.task))
        return self.minimised(program, candidate.point.xi, self._refining)

    def _turned(self, candidate: Polynomials) -> Polynomials | None:
        """
        Let thrusters that point elsewhere turn first: the same motions after coasting.

        The time a thruster needs depends on the motion and the motion on the time: a few rounds.
        None if that is not feasible.
        """
        for spare in (1.0, 1.03, 1.1):
            program, x = candidate.program, candidate.point.cache.x
            needed = self._needed_coast(program, x)
            needed[program.kept] = 0.0
            # A thruster that is off by little turns on, thrusting, as the shooting reckons with.
            short = needed - _ALIGNED / self.task.thruster_rate
            coast = program.task.coast
            if ((short <= coast) & (coast <= 1.2 * needed + 0.1)).all():
                return candidate
            later = program.with_task(replace(program.task, coast=spare * needed))
            better = self.minimised(later, later.reduce(x), self._refining)
            if not better:
                return None
            candidate = better[0]
        return candidate


def guesses(program: PolynomialProgram, rng: np.random.Generator) -> Iterator[Array]:
    """
    Yield initial guesses x (n, P): quintic motions bowed to either side by shares of their ways.

    Screened ones come first, best first, then random bows without end.
    """
    task, form = program.task, program.form
    durations = program.usual_durations()

    def bowed(bows: Array, s: Array, derivative: int = 0) -> Array:
        """Motions (n, c, 2, K) bowed by `bows` (n, c), or a derivative, at arcs s (n, K)."""
        way = task.goal - task.departure
        begin = task.departure, durations[:, None] * task.velocity
        conditions = np.stack([*begin, task.goal], axis=-1)
        quintic = PolynomialBasis.of((0, 1, 2), (0, 1, 2)).values(s, derivative)[..., [0, 1, 3]]
        straight = conditions @ np.swapaxes(quintic, 1, 2)
        normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
        power = 2 if form.vary_ends or form.order < 7 else 3
        # One in the middle of the arc.
        bump = (-4.0) ** power * PowerProducts(((power, power),)).values(s, derivative)[..., 0]
        side = bows[..., None, None] * normal[:, None, :, None] * bump[:, None, None]
        return np.asarray(straight[:, None] + side)

    def fit(bows: Array) -> Array:
        rates = np.tile(durations[:, None], program.nb)
        return program.fit(rates, lambda s: bowed(bows[:, None], np.tile(s, (task.n, 1)), 2)[:, 0])

    t = np.linspace(0.0, (durations + task.coast).max(), INSTANTS)
    s = np.clip((t - task.coast[:, None]) / durations[:, None], 0.0, 1.0)
    paths = bowed(np.broadcast_to(_BOWS, (task.n, _BOWS.size)), s)
    reach = task.separation / 2
    outside = np.maximum(reach - paths, paths - task.sides[:, None] + reach).max(axis=(2, 3))
    single = _LONGER * np.abs(_BOWS) * task.separation + _TOO_NEAR * np.maximum(outside, 0.0)
    paths = np.swapaxes(paths, 2, 3)
    for chosen in screened(program, paths, single, _BOWS, np.inf, _WANTED, _TOO_NEAR, rng):
        yield fit(_BOWS[chosen])
    while True:
        yield fit(rng.uniform(-0.35, 0.35, task.n))

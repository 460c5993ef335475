# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The search for formations' plans, whatever form their motions have.

Initial guesses are what every robot may choose, combined so that none comes too near another.
Which robot passes on which side of another decides which local minimum is found: of every set of
sides the combination that looks best is tried, the most promising first. The minimiser leads
to local minima; plans of them, with check and cost, are looked at cheapest first.

What is left of an earlier plan is an initial guess, or kept unchanged. A robot about to arrive has
no time to turn its thruster away and back: it keeps its motion, whose lateral errors the feedback
removes, and the others plan round it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import itertools
import math
from typing import Any, Final, TypeVar

import numpy as np
from tdm_planner.arrays import Array, Integers
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.plants.robot_replay import replay
from tdm_planner.problems.formation.parameters import FormationParameters
from tdm_planner.problems.formation.program import CLOSENESS, FormationProgram
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import (
    assessed,
    goal_state,
    keeps_reserve,
    start_state,
)
from tdm_planner.problems.problem import Search
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

C = TypeVar('C')
P = TypeVar('P', bound=FormationProgram)

LATE: Final = 3.0  # half-turns of the thruster before the arrival: away, thrusting, and back
_NEARLY_FEASIBLE = 2.5  # times the violation allowed, up to which a plan may survive the check
_INACTIVE_MARGIN = 2e-3  # margin of a separation that is not active
_SEARCH_SHARE = 0.75  # of the deadline, after which no other guess is tried once there is a plan
_SLOW_TURN = 0.25  # share of solver.longest for half a turn of the thruster, which is told
_CHECK_TIME = 4e-3, 2.5e-4  # s a robot, and s for any two of them,
_CHECK_SHARE = 0.45  # but no more than this share of the deadline
_MORE_MARGIN = 0.04  # of the separation, that is kept more where plans came too near
_SLOWER = 1.5  # half-turns of the thruster that motions then take longer
INSTANTS = 60  # at which the ways of choices are compared
_EXHAUSTIVE = 5000  # combinations of choices up to which all are screened
_TRIES = 30  # random combinations to begin with, where they are more
_SWEEPS = 6  # of a coordinate descent, at most
_START_ROUNDING = np.full(7, 1e-6)  # difference of a start from the plan's that is rounding
_MISSED = np.array([2e-3, 2e-3, 2e-3, 2e-3, 5e-3, 5e-3])  # by which the rest may miss the goal


class FormationSearch(Search[C]):
    """
    What the searches for a plan of a problem share.

    They make candidates in `rounds`, one after the other until there is a plan: first from the
    `rest` of the `previous` plan, then from `starts` initial guesses. `closest` is the point of
    the least violation seen, for the reason of a failure.
    """

    def __init__(
        self,
        task: FormationTask,
        settings: FormationParameters,
        rng: np.random.Generator,
        budget: Budget,
        previous: Solution | None,
    ) -> None:
        super().__init__(budget)
        self.task = self._original_task = task
        self.settings, self.rng, self.previous = settings, rng, previous
        self.starts, self.tried = settings.solver.starts, 0
        self.closest: Minimum[Any] | None = None
        left = {} if previous is None else previous.trajectories
        self.rest = dict(left) if set(left) == set(task.names) else {}
        self.kept: dict[str, Trajectory] = {}  # motions of robots that go on as before
        # The violation, relative to a limit, whose square is worth that penalty.
        self.feasible = math.sqrt(settings.solver.tolerance / np.max(settings.weights.penalty))
        self.rounds = self.prepared()

    @abstractmethod
    def prepared(self) -> list[Callable[[], Iterable[C]]]:
        """Return what makes the candidates of each round."""

    def candidates(self) -> Iterable[C]:
        """Minima of one round, cheapest first."""
        self.kept = {}
        return self.rounds[0]()

    def widen(self) -> bool:
        """
        Go on with the next round: farther apart where plans failed the check.

        Where they miss the goal for the second time they are made slower, too.
        """
        if self.rejected and not self.rest:
            again, task = self.task is not self._original_task, self.farther(self.task)
            slower = _SLOWER * task.half_turn if again and 'from the goal' in self.rejected else 0
            self.task = replace(task, shortest=task.shortest + slower)
        self.rounds.pop(0)
        return bool(self.rounds)

    @staticmethod
    def farther(task: FormationTask) -> FormationTask:
        """Return the manoeuvre with more distance to be kept."""
        return replace(task, margin=task.margin + _MORE_MARGIN * task.separation)

    def minimised(self, program: P, guess: Array, options: TrustRegionOptions) -> list[Minimum[P]]:
        """Return the minimum that a guess Xi leads to, if that is feasible."""
        if not program.free.size:
            return [Minimum(program, program.evaluate(np.zeros(0)), 0, converged=True)]
        minimum = minimise(program, guess, options, self._until_check)
        self.tried += 1
        violation = minimum.point.violation
        if self.closest is None or violation < self.closest.point.violation:
            self.closest = minimum
        # Constants so extreme that a motion has no numbers leave its margins without meaning.
        finite = math.isfinite(minimum.point.cost)
        return [minimum] if finite and violation <= _NEARLY_FEASIBLE * self.feasible else []

    def minima(
        self, program: P, guesses: Iterable[Array], options: TrustRegionOptions, worse: float
    ) -> list[Minimum[P]]:
        """
        Feasible local minima from guesses Xi, cheapest first.

        A start that is nearly feasible at `worse` times the best cost so far is aborted. Stops
        when the time is spent; once there is a minimum, after `starts` guesses or `_SEARCH_SHARE`
        of the deadline. Stops at once with a minimum where no separation binds, unless a plan has
        failed its check: passing on other sides is not cheaper.
        """
        found: list[Minimum[P]] = []
        for k, guess in enumerate(guesses):
            if found:
                best = min(each.point.cost for each in found)
                options = options._replace(cutoff=worse * best)
            alone = False
            for candidate in self.minimised(program, guess, options):
                found.append(candidate)
                nearest = candidate.point.cache.approaches[:, CLOSENESS].min(initial=1.0)
                alone = candidate.converged and not (nearest < _INACTIVE_MARGIN or self.rejected)
            late = self.budget.past(_SEARCH_SHARE)
            if self.budget.spent or alone or (found and (late or k + 1 >= self.starts)):
                break
        return sorted(found, key=lambda each: each.point.cost)

    def assessed(self, motions: Mapping[str, Trajectory], parameters: Array) -> Solution:
        """Return the motions with their check and cost, those that were kept among them."""
        return assessed(self._original_task, self.settings, {**motions, **self.kept}, parameters)

    def accept(self, plan: Solution) -> bool:
        """Return True, to end the search, if half the distance for the tracking is left."""
        return keeps_reserve(self._original_task, plan.verification)

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        turn, slow = self.task.half_turn, ''
        if turn > _SLOW_TURN * self.task.longest:
            slow = f'; the thruster takes {turn:.3g} s for half a turn (limits.thruster_rate)'
        if self.rejected:
            return VerificationFailed(f'no plan survived the check: {self.rejected}{slow}')
        closest, late = self.closest, self._until_check.spent
        within = f' within {self.budget.seconds:g} s' if late else ''
        found = f'no feasible plan{within} from {self.tried} initial guesses'
        if closest is not None:
            found += f'; the best one violates {closest.program.binding(closest.point)}'
        found += slow
        return DeadlineExceeded(found) if late else Infeasible(found)

    @property
    def _until_check(self) -> Budget:
        """What is left when the search must end is for the check."""
        one, two = _CHECK_TIME
        return self.budget.leaving((one + two * self.task.n) * self.task.n, _CHECK_SHARE)


def screened(
    program: FormationProgram,
    paths: Array,
    single: Array,
    bows: Array,
    meeting: float,
    wanted: float,
    price: float,
    rng: np.random.Generator,
) -> Integers:
    """
    Return combinations (m, n) of choices, the best of every set of sides, the best set first.

    `paths` (n, c, K, 2) are the ways of every robot's choices at equal times, `single` (n, c)
    what they cost. A metre that robots are nearer than `wanted` clearances, or than they may to
    what stands still, costs `price`. Sides are those of robots that come within `meeting`
    clearances of one another, and the signs of `bows` (c,).
    """
    n, count = single.shape
    reach = program.clearances[:n, n:]
    apart = np.linalg.norm(paths[:, :, None] - program.centres[:, None], axis=-1).min(axis=-1)
    single = single + price * np.maximum(reach[:, None] - apart, 0.0).sum(axis=-1)
    pair, sides = np.zeros((2, n, n, count, count))
    couples = list(itertools.combinations(range(n), 2))
    for i, j in couples:
        clearance = program.clearances[i, j]
        if clearance == 0.0:
            continue
        nearest, sense = _encounters(paths[i], paths[j])
        sides[i, j] = sense * (nearest < meeting * clearance)
        pair[i, j] = price * np.maximum(wanted * clearance - nearest, 0.0)
        pair[j, i] = pair[i, j].T
    combinations = _combined(single, pair, rng)
    passed = np.zeros((len(combinations), len(couples)))
    for q, (i, j) in enumerate(couples):
        passed[:, q] = sides[i, j][combinations[:, i], combinations[:, j]]
    turned = np.sign(bows[combinations])[:, program.varied]
    _, first = np.unique(np.hstack([passed, turned]), axis=0, return_index=True)
    return combinations[np.sort(first)]


def _encounters(one: Array, other: Array) -> tuple[Array, Array]:
    """Least distances (c, d) of paths (c, K, 2), (d, K, 2), and the sense in which they pass."""
    away = one[:, None] - other
    distances = np.hypot(away[..., 0], away[..., 1])
    at = np.clip(distances.argmin(axis=2), 1, one.shape[1] - 2)[..., None, None]
    before, here, after = (np.take_along_axis(away, at + k, axis=2)[:, :, 0] for k in (-1, 0, 1))
    sense = here[..., 0] * (after - before)[..., 1] - here[..., 1] * (after - before)[..., 0]
    return distances.min(axis=2), np.where(sense > 0.0, 1.0, -1.0)


def _combined(single: Array, pair: Array, rng: np.random.Generator) -> Integers:
    """
    Return combinations (m, n) of what every robot may choose, the cheapest first.

    `single` (n, c) is the cost of each robot's choices, `pair` (n, n, c, c) what a choice of one
    robot and a choice of another cost together. All of them, where they are not too many; else
    the first of all choices, and others by coordinate descent from random ones.
    """
    n, c = single.shape
    if c**n <= _EXHAUSTIVE:
        every = np.array(list(itertools.product(range(c), repeat=n)))
    else:
        drawn = (np.asarray(rng.integers(0, c, n), dtype=np.intp) for _ in range(_TRIES))
        descended = [_descended(single, pair, choice, rng) for choice in drawn]
        every = np.array([np.zeros(n, dtype=np.intp), *descended])
    total = single[np.arange(n), every].sum(axis=1)
    for i, j in itertools.combinations(range(n), 2):
        total += pair[i, j][every[:, i], every[:, j]]
    return np.asarray(every[np.argsort(total, kind='stable')])


def _descended(single: Array, pair: Array, choice: Integers, rng: np.random.Generator) -> Integers:
    """Improve what every robot chooses (n,), one robot at a time and in random order."""
    n = len(choice)
    for _ in range(_SWEEPS):
        before = choice.copy()
        for i in rng.permutation(n):
            cost = single[i] + pair[i, np.arange(n), :, choice].sum(axis=0)
            choice[i] = int(np.argmin(cost))
        if (choice == before).all():
            break
    return choice


def kept_motions(task: FormationTask, plans: Mapping[str, Trajectory]) -> dict[str, Trajectory]:
    """
    Motions of the robots that are to keep what is left of `plans`, by name.

    They start on their plans, end at their goals, and have less time before them than three
    half-turns of the thruster take.
    """
    found = {}
    for i, name in enumerate(task.names):
        plan, start = plans.get(name), start_state(task, i)
        if task.staying[i] or plan is None or not plan.duration < LATE * task.half_turn:
            continue
        if (np.abs(plan.states[0] - start) < _START_ROUNDING).all():
            begun = replace(plan, states=np.concatenate([start[None], plan.states[1:]]))
            states = replay(task.plant, begun, plan.times)
            if (np.abs(states[-1] - goal_state(task, i))[:6] < _MISSED).all():
                found[name] = replace(plan, states=states)
    return found

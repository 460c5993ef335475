# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The search for formations' plans by thrust arcs: rounded polylines, the shared minimiser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import itertools
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.problems.base import Solution
from tdm_planner.problems.formation_search import assessed
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import keeps_reserve
from tdm_planner.problems.kept_motion import kept_motions, LATE
from tdm_planner.problems.search import Plan, Search
from tdm_planner.problems.thrust_arcs_fit import fitted, remaining, resumed
from tdm_planner.problems.thrust_arcs_kernels import WEAKEST
from tdm_planner.problems.thrust_arcs_motion import arc_trajectory, cleaned
from tdm_planner.problems.thrust_arcs_program import ArcProgram, HeldMotion
from tdm_planner.problems.thrust_arcs_seeds import ArcSeeds, MANY, reseated
from tdm_planner.problems.warm_start import elapsed_on
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

FEW = 8  # robots up to which plans are looked for directly, without one of polynomials
_DESPERATE = 12  # random guesses, as long as nothing is found
_WORSE = 1.04  # times the best cost so far: a start that is nearly feasible there is given up
_PROMISING = 1.01  # times the best cost: minima that are polished
_POLISHED = 2  # of them at most
_PENALTY, _PENALTY_MANY = 0.5, 3.0
_ROUGH, _FINE = 1e-3, 2e-4  # predicted decrease of J at which a minimum is one
_RADIUS, _POLISHING_RADIUS = 0.3, 0.1
_ITERATIONS = 50
_FEASIBLE = 1e-3  # violation at which the minimiser may end
_NEARLY_FEASIBLE = 2.5  # times that: with the reserve of the clearances, what survives the check
_SEARCH_SHARE = 0.7  # of the deadline, after which no other guess is tried once there is a plan
_CHECK_TIME, _CHECK_SHARE = 5e-3, 0.45  # s a robot, but no more than this share of the deadline
_ROUNDS = 3  # of guesses, each keeping more distance
_MORE_MARGIN = 0.04  # of the separation, that a further round keeps more


@dataclass(frozen=True)
class ArcCandidate:
    """A local minimum: the program it solves and the point found."""

    program: ArcProgram
    point: Point

    @property
    def cost(self) -> float:
        """Return the performance index, gas rounded off."""
        return self.point.cost * self.program.scale

    @property
    def crowded(self) -> bool:
        """Whether a separation binds, so that other sides to pass on may be cheaper."""
        return bool(self.point.cache.closeness.min(initial=1.0) < 2 * _FEASIBLE)

    def motions(self, task: FormationTask) -> dict[str, Trajectory]:
        """Write the motions out, of the robots that are not held."""
        program, values = self.program, self.point.cache
        weakest = WEAKEST * program.fleet.speed
        found = {}
        for i, name in enumerate(task.names):
            if i in program.held:
                continue
            duration, burns = float(values.x[i, -1]), values.burns[i]
            kept = np.zeros((0, 4))
            if program.varied[i]:
                kept = cleaned(task, i, burns, duration, weakest)
            found[name] = arc_trajectory(task, i, kept, duration)
        return found


Candidate: TypeAlias = ArcCandidate | Plan


def compile_arcs(task: FormationTask) -> None:
    """Compile the kernels or load them from the disk."""
    program = ArcProgram(task)
    guess = program.reduce(next(ArcSeeds(program, np.random.default_rng(0)).screened()))
    point = program.evaluate(guess)
    program.linearise(point, None)
    ArcCandidate(program, point).motions(task)


def rest_of(task: FormationTask, previous: Solution) -> dict[str, Trajectory]:
    """Return what is left of a plan with thrust arcs for the same robots; nothing of others."""
    plans = previous.trajectories
    if set(plans) != set(task.names):
        return {}
    if any(plan.interpolation != 'zero_order_hold' for plan in plans.values()):
        return {}
    state = np.concatenate([task.start, task.velocity], axis=1)
    now = elapsed_on([plans[name] for name in task.names], state)
    least = 1e-3
    return {
        name: plans[name].after(max(min(now, plans[name].duration - least), 0.0))
        if now > 0.0
        else plans[name]
        for name in task.names
    }


class ArcSearch(Search[Candidate]):
    """
    Local minima of one manoeuvre from screened and random guesses, and their plans.

    `polynomials` returns a plan by the other method, or raises Infeasible: the guess where robots
    are many, and the last resort. `reserve` is the share of the thrust that burns leave to the
    feedback. `penalty_weights` (4,) are k1 to k4 of (29), `tolerance` eps of
    (10). Of a `previous` plan with thrust arcs the rest is the first guess; robots about to arrive
    keep theirs.
    """

    def __init__(
        self,
        task: FormationTask,
        rng: np.random.Generator,
        budget: Budget,
        polynomials: Callable[[Budget], Plan],
        *,
        starts: int,
        reserve: float,
        penalty_weights: Array,
        tolerance: float,
        previous: Solution | None = None,
    ) -> None:
        super().__init__(budget)
        self.task = replace(task, thrust=(1.0 - reserve) * task.thrust)
        self.starts, self.rng = starts, rng
        self.tried = 0
        self._required = task
        self._polynomials = polynomials
        self._penalty_weights, self._tolerance = penalty_weights, tolerance
        self._round = 1
        self._kept: dict[str, Trajectory] = {}
        self._rest: dict[str, Trajectory] = {}
        if previous is not None:
            self._rest = rest_of(task, previous)
            self._round = 0 if self._rest else 1
        self._last: Infeasible | None = None

    def candidates(self) -> Iterator[Candidate]:
        """Minima, cheapest first; in the last round the plan by polynomials."""
        if self._round < 1:
            yield from self._resumed()
            return
        self._kept = {}
        if self._round < _ROUNDS and self.task.n <= FEW:
            yield from self.minima()
            return
        self._round = _ROUNDS
        try:
            plan = self._polynomials(self.budget)
        except Infeasible as error:
            self._last = error
            return
        yield from self._improved(plan)
        yield plan

    def minima(self) -> list[ArcCandidate]:
        """Feasible local minima, cheapest first, the most promising of them polished."""
        program = ArcProgram(self.task)
        found: list[ArcCandidate] = []
        for k, guess in enumerate(self._guesses(program)):
            best = min((candidate.point.cost for candidate in found), default=None)
            candidate = self._minimise(
                program, program.reduce(guess), cutoff=None if best is None else _WORSE * best
            )
            if candidate is not None:
                found.append(candidate)
            alone = candidate is not None and not candidate.crowded
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            enough = found and k + 1 >= self.starts
            if self.budget.spent or alone or enough or (late and found):
                break
        found.sort(key=lambda each: each.cost)
        for k, candidate in enumerate(found[:_POLISHED]):
            if candidate.cost < _PROMISING * found[0].cost and not self.budget.spent:
                found[k] = self._polished(candidate)
        return sorted(found, key=lambda each: each.cost)

    def _guesses(self, program: ArcProgram) -> Iterator[Array]:
        seeds = ArcSeeds(program, self.rng)
        yield from itertools.islice(seeds.screened(), self.starts)
        for _ in range(_DESPERATE):
            yield seeds.random()

    def _resumed(self) -> Iterator[ArcCandidate]:
        """Yield the minimum that the rest of the plan before leads to."""
        task = self.task
        self._kept = {}
        for half_turns in (1.0, LATE):
            fewer, self._kept = self._kept, kept_motions(task, self._rest, half_turns)
            if half_turns > 1.0 and len(self._kept) == len(fewer):
                break
            x = resumed(task, self._rest, self._kept)
            held = {
                task.names.index(name): HeldMotion(remaining(motion), motion.duration)
                for name, motion in self._kept.items()
            }
            count = max([(x.shape[1] + 4) // 3, *(len(each.burns) for each in held.values())])
            if count > (x.shape[1] + 4) // 3:
                break
            program = ArcProgram(task, count, held)
            xi = np.clip(program.reduce(x), program.lower, program.upper)
            candidate = self._minimise(program, xi, _POLISHING_RADIUS)
            if candidate is not None:
                yield candidate

    def _improved(self, plan: Plan) -> Iterator[ArcCandidate]:
        """Yield the minimum with four burns a robot near a plan of polynomials, if there is."""
        program = ArcProgram(self.task, 4)
        xi = program.reduce(fitted(program, plan.trajectories))
        candidate = self._minimise(program, xi, _POLISHING_RADIUS)
        if candidate is not None:
            yield candidate

    def _minimise(
        self,
        program: ArcProgram,
        xi: Array,
        radius: float = _RADIUS,
        tolerance: float = _ROUGH,
        cutoff: float | None = None,
    ) -> ArcCandidate | None:
        """Minimise from Xi; None where that leads to nothing feasible."""
        if not program.free.size:
            return ArcCandidate(program, program.evaluate(xi))
        options = TrustRegionOptions(
            penalties=(_PENALTY if self.task.n < MANY else _PENALTY_MANY,),
            feasibility=(_FEASIBLE,),
            radius=radius,
            iterations=_ITERATIONS,
            cost_tolerance=tolerance,
            cutoff=cutoff,
        )
        before = program.evaluations
        until = self.budget.leaving(_CHECK_TIME * self.task.n, _CHECK_SHARE)
        minimum = minimise(program, xi, options, until)
        self.tried += 1
        self.budget.evaluations += program.evaluations - before
        if not minimum.point.violation <= _NEARLY_FEASIBLE * _FEASIBLE:
            return None
        return ArcCandidate(program, minimum.point)

    def _polished(self, candidate: ArcCandidate) -> ArcCandidate:
        """Minimise on, with corners where robots that fly straight touch others."""
        program, point = candidate.program, candidate.point
        for radius in (_POLISHING_RADIUS, _POLISHING_RADIUS):
            x = reseated(program, point.cache)
            xi = candidate.point.xi if x is None else program.reduce(x)
            better = self._minimise(program, xi, radius, _FINE)
            if better is None or not better.cost < candidate.cost:
                break
            candidate, point = better, better.point
            if x is None:
                break
        return candidate

    def plans(self, candidate: Candidate) -> Iterator[Plan]:
        """Yield the plan of a candidate."""
        if isinstance(candidate, Plan):
            yield candidate
            return
        motions = candidate.motions(self.task)
        motions |= {name: self._kept[name] for name in self._required.names if name not in motions}
        motions = {name: motions[name] for name in self._required.names}
        yield assessed(
            self._required, motions, self._penalty_weights, self._tolerance, candidate.point.xi
        )

    def promises_more(self, candidate: Candidate, than: Candidate) -> bool:
        """Whether a candidate is cheaper than one that is verified."""
        return candidate.cost < than.cost

    def satisfied_with(self, plan: Plan) -> bool:
        """Whether the distance kept for the tracking is left, by half at least."""
        return keeps_reserve(self._required, plan.verification)

    def widen(self) -> bool:
        """Keep more distance, where plans failed the check; at last use polynomials."""
        self._round += 1
        if self._round == 1:
            return True
        if self._round == _ROUNDS - 1 and not self.rejected:
            self._round = _ROUNDS
        margin = self.task.margin + _MORE_MARGIN * self.task.separation
        self.task = replace(self.task, margin=margin)
        return self._round <= _ROUNDS

    def failure(self) -> Infeasible:
        """Return why there is no plan."""
        if self.rejected:
            return VerificationFailed(f'no plan survived the check: {self.rejected}')
        if self._last is not None:
            return self._last
        return DeadlineExceeded(
            f'no plan within {self.budget.seconds:g} s from {self.tried} starts'
        )

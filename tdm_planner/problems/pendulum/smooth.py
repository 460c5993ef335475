# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Methods `smooth` and `virtual_arc`: the swing-up stated as a problem like any other.

The disk's angle is a reference function, the torque follows by inverse dynamics, the pendulum is
integrated; the engine of all stated problems plans it. The torque is continuous, linear between
the samples. On the virtual arc theta goes one way all along, as in (9)-(16) of Yakimenko (2006),
where the angle is the argument of everything else.

Shooting cannot change the sequence of arcs that it starts from, and a pumped motion takes more
swings than the optimum. So method `switching` solves this statement once by collocation, which
often halves the time of a pumped motion. It reads new arcs from the torque found, with torques
between the extremes where the disk moves along its limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
import math
from typing import Any, ClassVar

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import CollocatedMotion, Collocation, WARM
from tdm_planner.direct_method.formulation import Duration, Integrated, Output
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.tracing import Trace
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, InvalidProblem
from tdm_planner.parameters import group, parameter
from tdm_planner.plants.rotary_pendulum import accelerations, driven, RotaryPendulum
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.direct.refinement import Refinement
from tdm_planner.problems.pendulum.candidates import Candidate, trajectory
from tdm_planner.problems.pendulum.task import (
    PendulumStart,
    SwingUpTask,
    TERMINAL_TOLERANCE,
)
from tdm_planner.problems.problem import Search
from tdm_planner.problems.solution import Solution

_FREE = 12  # varied parameters of the disk's angle
_SWITCHING_SHARE = 0.4  # of the time allowed, for a switching torque to begin from
_ANOTHER_SHARE = 0.5  # of the time allowed, after which one goal is enough
_FIRST_SHARE = 0.7  # of the time allowed, for the nearest way up
_LONGER, _LEAST = 4.5, 0.3  # of the time scale of the transfer, and of 1/w0: a guess of the time
_INTERVALS, _SETTINGS = 60, replace(WARM, barrier=1e-1)  # of the collocation; the optimum is far
_SWITCH = 0.8  # of the torque, by which it changes within an interval that a switch divides
_EXTREME = 0.97  # of the torque, from which it counts as all of it
_ALIKE = 0.1, 0.3  # of the torque, by which that of one arc may vary: finely and coarsely read


@dataclass(frozen=True)
class StatedSwingUp(DirectProblem):
    """A swing-up to theta = `goal` with a continuous torque, as `SwingUpTask` has it."""

    name: ClassVar[str] = 'pendulum_swing_up'
    state_names = RotaryPendulum.state_names
    state_units = RotaryPendulum.state_units
    control_names = RotaryPendulum.control_names
    control_units = RotaryPendulum.control_units
    terminal_tolerance = tuple((0.5 * TERMINAL_TOLERANCE).tolist())

    plant: RotaryPendulum = group(RotaryPendulum)
    start: PendulumStart = group(PendulumStart)
    goal: float = parameter(0.0, "pendulum's angle at the end", unit='rad')
    torque: float = parameter(0.02, 'largest torque', unit='N m')
    disk_angle: float = parameter(2.0, 'largest angle of the disk', unit='rad')
    time: float = parameter(0.5, 'guess of the time', unit='s')
    one_way: bool = parameter(False, 'whether theta goes one way all along')

    @classmethod
    def of(cls, task: SwingUpTask, turns: int, one_way: bool = False) -> StatedSwingUp:
        """Return the swing-up of a task to theta = 2 pi `turns`."""
        return cls(
            plant=task.plant,
            start=replace(PendulumStart(*task.start.tolist()), torque=task.start_torque),
            goal=2.0 * math.pi * turns,
            torque=task.planned_torque,
            disk_angle=task.planned_disk_angle,
            time=max(_LONGER * task.transfer_time, _LEAST / task.plant.natural_frequency),
            one_way=one_way,
        )

    def outputs(self) -> dict[str, Output]:
        """Return the disk's angle; its acceleration at the start is that of the torque there."""
        start, given = self.start, [self.start.psi, self.start.psi_dot]
        if start.torque is not None:
            state = start.theta, start.theta_dot, start.psi_dot, start.torque
            given.append(float(accelerations(self.plant.coefficients, *state)[1]))
        return {'psi': Output(start=given, end=(0.0, 0.0), free=_FREE, scale=1.0)}

    def integrated(self) -> dict[str, Integrated]:
        """Return the pendulum's angle and rate."""
        speed = self.plant.natural_frequency
        return {
            'theta': Integrated(self.start.theta, self.goal),
            'theta_dot': Integrated(self.start.theta_dot, 0.0, scale=speed),
        }

    def duration(self) -> Duration:
        """Return the guess."""
        return Duration(guess=self.time)

    def invert(self, y: Any, z: Any) -> Any:
        """Return the torque at which the disk moves so."""
        psi, psi_dot, psi_ddot = y['psi']
        theta, theta_dot = z['theta'], z['theta_dot']
        _, torque = driven(self.plant.coefficients, theta, theta_dot, psi_dot, psi_ddot)
        return (theta, psi, theta_dot, psi_dot), (torque,)

    def derivative(self, x: Any, u: Any) -> Any:
        """Return the rates."""
        return self.plant.equations(self.plant.coefficients, x, u)

    def margins(self, t: Any, x: Any, u: Any) -> dict[str, Any]:
        """Return what is left of the disk's angle; on the virtual arc also of the speed."""
        share = x[1] / self.disk_angle
        limits = {'disk_angle': 1.0 - share, '-disk_angle': 1.0 + share}
        if self.one_way:
            way = np.sign(self.goal - self.start.theta)
            limits['one way'] = way * x[2] / self.plant.natural_frequency
        return limits

    def control_limits(self) -> dict[str, tuple[float, float]]:
        """Return the torque's."""
        return {'torque': (-self.torque, self.torque)}

    def final_cost(self, t: Any, x: Any) -> Any:
        """Return the time."""
        return t


class ContinuousTorqueSearch(Search[Solution]):
    """
    The search for the quickest continuous torque to the nearest two upright positions.

    What is left of a `previous` plan is tried first, else the swing-up that `switching` finds in
    the time it is given: that is quick, but keeps its swings.
    """

    def __init__(
        self,
        task: SwingUpTask,
        budget: Budget,
        rng: np.random.Generator,
        one_way: bool,
        switching: Callable[[Budget], Solution],
        previous: Solution | None = None,
    ) -> None:
        super().__init__(budget)
        self._task, self._rng = task, rng
        self._one_way, self._previous, self._switching = one_way, previous, switching
        self._refusal: Infeasible | None = None

    def candidates(self) -> Iterator[Solution]:
        """Plan from a switching torque, for the nearest goal, and for the next one in time."""
        for turns, share, previous in self._attempts():
            plan = self._continuous(turns, share * self.budget.remaining, previous)
            if plan is not None:
                yield plan
                if self.budget.past(_ANOTHER_SHARE):
                    return

    def _attempts(self) -> Iterator[tuple[int, float, Solution | None]]:
        """Yield goals, each with its share of the time left, and the plan to begin from."""
        if self._previous is None and not self._one_way:
            with suppress(Infeasible):
                plan = self._switching(self.budget.part(_SWITCHING_SHARE * self.budget.remaining))
                yield self._task.turns_nearest(plan.trajectory.states[-1]), 1.0, plan
        for number, turns in enumerate(self._goals()):
            yield turns, (1.0 if number else _FIRST_SHARE), self._previous

    def _continuous(
        self, turns: int, seconds: float, previous: Solution | None
    ) -> Solution | None:
        """Return the plan to theta = 2 pi `turns` that is found in `seconds` [s], if any."""
        task = replace(self._task, whole_range=True)  # it is planned for once
        stated = StatedSwingUp.of(task, turns, self._one_way)
        search = stated.search(self.budget.part(seconds), self._rng, previous)
        try:
            return search.run()
        except Infeasible as error:
            self._refusal = self._refusal or error
        except InvalidProblem as error:  # what is stated here is right: its numbers are not
            raise FloatingPointError(str(error)) from error
        return None

    def plans(self, candidate: Solution) -> Iterator[Solution]:
        """Yield the plan with the check that all swing-ups pass."""
        yield self._task.plan(candidate.trajectory, candidate.parameters, candidate.penalty)

    def is_worth_checking(self, candidate: Solution, plan: Solution) -> bool:
        """Whether it is quicker."""
        return candidate.cost < plan.cost

    def accept(self, plan: Solution) -> bool:
        """Return True, to end the search, if the plan goes on from a previous one."""
        return self._previous is not None

    def widen(self) -> bool:
        """Return False: the searches have tried all they can."""
        return False

    def failure(self) -> Infeasible:
        """Return why there is none."""
        task = self._task
        if self._one_way and not self._goals():
            begins = 'starts upright'
            if task.start[2]:
                turns = 'upright' if task.turns is None else f'goal.turns = {task.turns}'
                begins = f'starts with theta_dot = {task.start[2]:g} rad/s away from {turns}'
            return Infeasible(
                "method 'virtual_arc' needs theta to go one way all along, but the pendulum "
                f"{begins}; method 'switching' has no such restriction"
            )
        way = ', theta going one way all along,' if self._one_way else ''
        what = (
            f'no swing-up with a continuous torque of at most {task.planned_torque:.3g} N m '
            f'(limits.torque less torque_reserve){way} was found'
        )
        remedy = "method 'switching' may find one"
        if self._refusal is None or isinstance(self._refusal, DeadlineExceeded):
            return DeadlineExceeded(f'{what} in {self.budget.seconds:g} s; {remedy}')
        reason = self.rejected or str(self._refusal)
        return type(self._refusal)(f'{what}: {reason}; {remedy}')

    def _goals(self) -> Sequence[int]:
        """Numbers n of theta = 2 pi n, the nearest first."""
        theta, _, theta_dot, _ = self._task.start.tolist()
        ahead = (theta + theta_dot / self._task.plant.natural_frequency) / (2.0 * math.pi)
        if self._task.turns is not None:
            goals = [self._task.turns]
        else:
            goals = sorted({math.floor(ahead), math.ceil(ahead)}, key=lambda n: abs(n - ahead))
        if self._one_way:
            here = theta / (2.0 * math.pi)
            ways = ((n, math.copysign(1.0, n - here)) for n in goals if abs(n - here) > 1e-9)
            goals = [n for n, way in ways if way * theta_dot >= 0.0]
        return goals


def prepare_collocation(stated: StatedSwingUp) -> None:
    """Make the program, so that the first plan does not wait."""
    Collocation.of(Trace.of(CheckedFormulation(stated)), _INTERVALS, _SETTINGS)


def collocated(task: SwingUpTask, candidate: Candidate, until: Budget) -> Iterator[Candidate]:
    """Yield arcs of what collocation makes of a candidate in time: finely and coarsely read."""
    stated = StatedSwingUp.of(replace(task, start_torque=None), candidate.turns)
    motion = trajectory(task, candidate)
    sample = motion.sample(motion.duration * np.linspace(0.0, 1.0, 2 * _INTERVALS + 1))
    states, torques = sample.state, sample.control[::2]
    guess = CollocatedMotion(states[::2], states[1::2], torques, motion.duration)
    refinement = Refinement(DirectPlant(stated), until)
    found = refinement.solve(_INTERVALS, guess, _SETTINGS, unfinished=True)
    if found is not None:
        shares = np.clip(found.controls[:, 0] / task.planned_torque, -1.0, 1.0)
        for alike in _ALIKE:
            durations, levels = _arcs(shares, found.duration / _INTERVALS, alike)
            yield Candidate(durations, task.planned_torque * levels, candidate.turns)


def _arcs(torques: Array, interval: float, alike: float) -> tuple[Array, Array]:
    """Return durations [s] and torques, as shares, of arcs; given `torques` (n + 1,) at nodes."""
    arcs: list[tuple[float, float]] = []
    for first, last in zip(torques[:-1].tolist(), torques[1:].tolist(), strict=True):
        mean = 0.5 * (first + last)
        parts = [(interval, mean if abs(mean) < _EXTREME else math.copysign(1.0, mean))]
        if abs(last - first) > _SWITCH:
            sign = math.copysign(1.0, first - last)
            before = 0.5 * (1.0 + sign * mean) * interval
            parts = [(before, sign), (interval - before, -sign)]
        for duration, torque in parts:
            if arcs and abs(arcs[-1][1] - torque) < alike:
                length, other = arcs.pop()
                torque = (length * other + duration * torque) / (length + duration)
                duration += length
            arcs.append((duration, torque))
    durations, shares = np.array(arcs).T.copy()  # kernels are compiled for rows in one piece
    return durations, shares

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What tests of trackers and of the replanner share: plans, and closed loops stepped by a clock.

`Loop` steps one of them, `RecedingHorizon` of `benchmark.receding` several with a replanner.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
import functools
import math

from benchmark.receding import CommandedPlant, tracked
import numpy as np
from tdm_planner.arrays import wrapped
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.replanning.execution import Observation, TimedPlan
from tdm_planner.tracking.motion import Command, ObservedPhase
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker, RobotTrackerParameters
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_planner.trajectory import Trajectory

WEAK, STRONG = 0.02, 0.09  # N m
HANGING = np.array([math.pi, 0.0, 0.0, 0.0])
SWING = build(PendulumSwingUp, {'limits.torque': WEAK})
FORMATION = RobotFormation()


@functools.cache
def swing_up() -> TimedPlan:
    """Return the swing-up by a weak motor, from 0 s on."""
    return TimedPlan(SWING, SWING.solve(deadline=10.0), start=0.0)


@functools.cache
def crossing() -> TimedPlan:
    return TimedPlan(FORMATION, FORMATION.solve(deadline=10.0), start=0.0)


def states_on(plan: TimedPlan, at: float) -> dict[str, np.ndarray]:
    motions = plan.solution.trajectories
    return {name: motion.sample(plan.elapsed(at)).state for name, motion in motions.items()}


def seen(states, at, phase=ObservedPhase.FOLLOWING, followed=None, **away):
    """Return what a replanner sees of vehicles, each so far `away` from a state."""
    where = {name: state + away.get(name, 0.0) for name, state in states.items()}
    return {name: Observation(state, at, phase, followed) for name, state in where.items()}


def moved(state: np.ndarray, *change: float) -> np.ndarray:
    return np.asarray(state + np.array(change))


def dotted(values: dict) -> dict:
    return {name.replace('__', '.'): value for name, value in values.items()}


def pendulum_tracker(limit: float = STRONG, **values) -> PendulumTracker:
    """Return a tracker for a motor; `values` are its other parameters, `__` for the dot."""
    asked = {'limits.torque': limit, **dotted(values)}
    return PendulumTracker(build(PendulumTrackerParameters, asked))


def pendulum(tracker, initial=HANGING, mismatch=0.0, noise=0.0, seed=0) -> CommandedPlant:
    """Return a tracker with its plant; `noise` is a multiple of the usual sensors'."""
    return tracked(tracker, initial, mismatch, noise, seed)


def robot(initial, mismatch=0.0, noise=0.0, seed=0, **own) -> CommandedPlant:
    """Return a robot and its tracker; `own` are the tracker's parameters, `__` for the dot."""
    given = build(RobotTrackerParameters, {'rate': 50.0, **dotted(own)})
    return tracked(RobotTracker(given), initial, mismatch, noise, seed)


@dataclass
class Loop:
    """
    A vehicle stepped by its tracker's rate.

    `delay` ticks pass before a state is seen, `late` s before a command acts.
    """

    vehicle: CommandedPlant
    delay: int = 0
    late: float = 0.0
    seen_as: Callable[[np.ndarray], np.ndarray] = staticmethod(lambda state: state)
    states: list[np.ndarray] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tracker: TrajectoryTracker = self.vehicle.tracker
        self.plant = self.vehicle.plant
        self.tick = self.tracker.parameters.interval
        self._samples: list[tuple[np.ndarray, float]] = []

    @property
    def now(self) -> float:
        return len(self.states) * self.tick

    @property
    def controls(self) -> np.ndarray:
        return np.array([command.control for command in self.commands])

    def run(self, duration: float) -> 'Loop':
        for _ in range(round(duration / self.tick)):
            now = self.now
            self._samples.append((self.plant.measure(), now))
            if len(self._samples) > self.delay:
                state, stamp = self._samples[-1 - self.delay]
                self.tracker.observe(self.seen_as(state), stamp)
            self.commands.append(self.tracker.command(now))
            self.plant.step(self.late)
            self.plant.command(self.commands[-1].control)
            self.plant.step(self.tick - self.late)
            self.states.append(self.plant.state)
        return self

    def upright(self, last: float) -> bool:
        count = round(last / self.tick)
        return bool(np.abs(wrapped(np.array(self.states[-count:])[:, 0])).max() < 0.05)

    def begin(self, plan: Trajectory, start: float = 0.1) -> 'Loop':
        """Measure for a moment, then accept a plan that starts `start` s after the beginning."""
        begun = self.now
        self.run(0.06)
        self.tracker.accept(plan, begun + start, self.now)
        return self

    def push(self, *change: float) -> None:
        self.plant.push(lambda state: moved(state, *change))

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Trackers, simulated plants and the replanner stepped together, without ROS, planning late.

The same code as the nodes': a plan made from the states measured at t reaches the trackers later
and starts at t + replan.delay; plants are known by their sensors only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from tdm_planner.arrays import Array
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning.execution import Observation, TimedPlan
from tdm_planner.replanning.replanner import PublishedPlans, Replanner, Review
from tdm_planner.tracking.motion import Command, ObservedPhase, TrajectoryRejected
from tdm_planner.tracking.tracker import TrajectoryTracker
from tdm_sim.simulation import SimulatedPlant
from tdm_sim.study.flights import plant_of

_ARRIVAL = 0.85  # of replan.delay, after which a plan has reached the trackers


class CommandedPlant(NamedTuple):
    """A simulated plant, and the tracker that commands it."""

    tracker: TrajectoryTracker
    plant: SimulatedPlant


def tracked(
    tracker: TrajectoryTracker, initial: Array, mismatch: float, noise: float, seed: int
) -> CommandedPlant:
    """Return a tracker with its simulated plant, which `plant_of` makes."""
    return CommandedPlant(tracker, plant_of(tracker, initial, mismatch, noise, seed))


@dataclass
class RecedingHorizon:
    """
    Vehicles by name, stepped by `interval` s; `problem` is what is asked at present.

    `plans` are those that became active, `reviews` what the replanner made of it (at most once
    an interval of 1 / replan.rate), `rejections` what the trackers did not accept. `replanner`
    makes that of a plan; without it the first plan is all there is.
    """

    vehicles: Mapping[str, CommandedPlant]
    problem: Problem
    interval: float
    replanner: Callable[[TimedPlan], Replanner] | None = None
    plans: list[TimedPlan] = field(default_factory=list)
    reviews: list[Review] = field(default_factory=list)
    rejections: list[str] = field(default_factory=list)
    time: float = 0.0
    _published: PublishedPlans = field(default_factory=PublishedPlans)
    _coming: tuple[float, TimedPlan] | None = None
    _next_review: float = 0.0
    _replanner: Replanner | None = None

    def begin(self, plan: TimedPlan) -> None:
        """Execute a plan that starts now."""
        for vehicle in self.vehicles.values():
            vehicle.tracker.observe(vehicle.plant.measure(), self.time - self.interval)
        self._activate(plan, self.time - self.interval)

    def tick(self) -> None:
        """Measure, command, review if it is time to, move."""
        now = self.time
        measured = {name: vehicle.plant.measure() for name, vehicle in self.vehicles.items()}
        for name, vehicle in self.vehicles.items():
            vehicle.tracker.observe(measured[name], now)
        if self._coming is not None and now >= self._coming[0]:
            self._activate(self._coming[1], now)
            self._coming = None
        commands = {name: v.tracker.command(now) for name, v in self.vehicles.items()}
        seen = {
            name: Observation(
                measured[name],
                now,
                observed_phase(command),
                self._followed(self.vehicles[name].tracker),
            )
            for name, command in commands.items()
        }
        self._review(seen, now)
        for name, vehicle in self.vehicles.items():
            vehicle.plant.command(commands[name].control)
            vehicle.plant.step(self.interval)
        self.time = now + self.interval

    @staticmethod
    def _followed(tracker: TrajectoryTracker) -> float | None:
        """Return the start [s] of the plan that a tracker follows."""
        return None if tracker.current is None else tracker.current.start

    def _review(self, seen: Mapping[str, Observation], now: float) -> None:
        replanner, make = self._replanner, self.replanner
        if replanner is None or self._coming is not None or now < self._next_review - 1e-9:
            return
        self._next_review = now + 1.0 / replanner.parameters.rate
        plan, told = self._published.reviewed(seen, now)
        if plan is None:
            return
        if make is not None and plan is not replanner.execution.plan:
            self._replanner = replanner = make(plan)
        review = replanner.review(self.problem, seen, now, told)
        self.reviews.append(review)
        if review.plan is not None:
            self._coming = now + _ARRIVAL * replanner.parameters.delay, review.plan

    def _activate(self, plan: TimedPlan, now: float) -> None:
        for name, vehicle in self.vehicles.items():
            try:
                vehicle.tracker.accept(plan.solution.trajectories[name], plan.start, now)
            except TrajectoryRejected as rejection:
                self.rejections.append(str(rejection))
        self.plans.append(plan)
        self._published.add(plan)
        self._replanner = None if self.replanner is None else self.replanner(plan)


def observed_phase(command: Command) -> ObservedPhase:
    """Return what a tracker that sends this command does."""
    if command.action is not None:
        return ObservedPhase.FOLLOWING
    return ObservedPhase.RECOVERING if command.control.any() else ObservedPhase.IDLE

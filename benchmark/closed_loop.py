# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Closed-loop experiments: the tracker's own code against simulated plants that are not its model.

Run as ``python benchmark/closed_loop.py``; prints a table. A pendulum counts as caught and held
when |theta - 2 pi n| < 0.05 rad and |psi| < psi_max throughout the last 5 s, which begin 2 s after
the planned end.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import math
import time

import numpy as np

from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.tracker import wrapped
from tdm_planner.trajectory import Trajectory
from tdm_sim.mismatch import mismatched
from tdm_sim.simulation import PlantSetup, SimulatedPlant

SEEDS = 40
MISMATCH = 0.05
NOISE = np.array([0.0015, 0.0015, 0.1, 0.1])
SETTLING, HELD = 2.0, 5.0  # s
HELD_ANGLE = 0.05  # rad
DISK_ANGLE = 2.0  # rad


@dataclass(frozen=True)
class Run:
    """One closed loop: whether the pendulum was held, and how."""

    held: bool
    largest_angle: float
    largest_disk_angle: float
    path_error: float


def swing_up(plan: Trajectory, limit: float, interval: float, seed: int, mismatch: float) -> Run:
    """Track a plan on a mismatched plant with noise, one command every `interval` s."""
    parameters = build(PendulumTrackerParameters, {'rate': 1.0 / interval, 'limits.torque': limit})
    tracker = PendulumTracker(parameters)
    setup = PlantSetup(
        plant=mismatched(parameters.plant, mismatch, seed),
        initial=plan.states[0],
        lower=np.array([-limit]),
        upper=np.array([limit]),
        noise=NOISE,
    )
    plant = SimulatedPlant(setup, seed)
    tracker.observe(plant.measure(), 0.0)
    tracker.accept(plan, interval, 0.0)
    states, errors = [], []
    for tick in range(math.ceil((plan.duration + SETTLING + HELD) / interval)):
        now = tick * interval
        tracker.observe(plant.measure(), now)
        command = tracker.command(now)
        if command.action is not None and now < plan.duration:
            errors.append(tracker.error(plant.state, tracker.current.reference(now))[:2])
        plant.command(command.control)
        plant.step(interval)
        states.append(plant.state)
    angles = np.array(states)[-round(HELD / interval) :]
    largest = float(np.abs(wrapped(angles[:, 0])).max())
    disk = float(np.abs(np.array(states)[:, 1]).max())
    held = largest < HELD_ANGLE and np.abs(angles[:, 1]).max() < DISK_ANGLE
    return Run(bool(held), largest, disk, float(np.sqrt(np.mean(np.square(errors)))))


def pendulum_table(seeds: int, mismatch: float) -> None:
    """Print how many of `seeds` swing-ups are caught and held."""
    print(
        '| torque limit, reserve | interval | held | disk < 2 rad throughout | |theta| p50, max |'
    )
    print('|---|---|---|---|---|')
    for limit, reserve in ((0.09, 0.2), (0.02, 0.3)):
        problem = build(PendulumSwingUp, {'limits.torque': limit, 'torque_reserve': reserve})
        plan = problem.solve(deadline=5.0).trajectory
        for interval in (0.002, 0.005):
            began = time.process_time()
            runs = [swing_up(plan, limit, interval, seed, mismatch) for seed in range(seeds)]
            held = [run for run in runs if run.held]
            angles = [run.largest_angle for run in held] or [math.nan]
            print(
                f'| {limit} N m, {reserve} ({plan.duration:.3f} s) | {interval * 1e3:g} ms '
                f'| {len(held)}/{seeds} | {sum(r.largest_disk_angle < DISK_ANGLE for r in runs)} '
                f'| {np.median(angles):.4f}, {max(angles):.4f} |'
                f' <!-- {time.process_time() - began:.0f} s -->',
                flush=True,
            )


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--seeds', type=int, default=SEEDS)
    options.add_argument('--mismatch', type=float, default=MISMATCH)
    chosen = options.parse_args()
    pendulum_table(chosen.seeds, chosen.mismatch)


if __name__ == '__main__':
    main()

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Replanning while the plant moves: model errors, noise, a push mid-way, a goal that moves.

The replanner and the trackers are those of the nodes, reviews at 5 Hz; a plan made from the
states measured at t starts at t + replan.delay. Physical constants and actuator gains are off
by up to 5 %, measurements are noisy.

The pendulum (limits.torque .02 N m: it must pump) is pushed, half-way through the first plan, by
30 % of the largest angular momentum about its pivot of the planned swing, either way. It is caught
at once when from the first time that the regulator about upright acts it is never lost
again; it counts as held when |theta - 2 pi n| < .05 rad from 10 s after the start until 15 s after
it.

Of three robots that cross, one is pushed half-way by .05 m/s in a random direction; or the
formation is moved half-way by up to .5 m along each axis and .5 rad. They have arrived when every
one is within 2 cm of its goal throughout the last 3 of 5 s after the last plan's end, and are
separated when no two ever came closer than the minimum separation. Where pushes are to be
expected, plans must leave room for them: arena.tracking_margin is .1 m there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import math
from typing import Any

from benchmark.measuring import counted
from benchmark.receding import RecedingHorizon, tracked
from benchmark.scenarios import (
    ARRIVED,
    crossing_of,
    DISK_ANGLE,
    HELD_ANGLE,
    MINIMUM_SEPARATION,
    MISMATCH,
)
import numpy as np
from tdm_planner.arrays import Array, wrapped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.pendulum.task import PENDULUM_NAME
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.replanning.replanner import Replanner
from tdm_planner.replanning.swing_up_execution import SwingUpExecution
from tdm_planner.tracking.motion import Phase, ReplanOnDeviation
from tdm_planner.tracking.pendulum_tracking import PendulumTracker
from tdm_sim.simulation import mismatched, pendulum_push, robot_push
from tdm_sim.study.flights import tracker_of

REVIEWS = ReplanParameters(rate=5.0)
TORQUE, RESERVE, PUSH = 0.02, 0.3, 0.3
PENDULUM_INTERVAL, ROBOT_INTERVAL = 0.005, 0.02  # s
HELD_FROM, HELD_UNTIL = 10.0, 15.0  # s
ROBOT_PUSH, PUSH_MARGIN = 0.05, 0.1  # m/s, m
SETTLING, AT_GOAL = 5.0, 3.0  # s


def loop_of(
    problem: Problem,
    solution: Solution,
    interval: float,
    seed: int,
    replanner: Callable[[TimedPlan], Replanner],
) -> RecedingHorizon:
    """Return vehicles about to execute their plans, commanded every `interval` s."""
    recovers = ReplanOnDeviation(on_deviation=True)
    plans = solution.trajectories.items()
    vehicles = {
        name: tracked(
            tracker_of(problem, rate=1.0 / interval, replan=recovers),
            plan.states[0],
            MISMATCH,
            1.0,
            len(plans) * seed + number,
        )
        for number, (name, plan) in enumerate(plans)
    }
    loop = RecedingHorizon(vehicles, problem, interval, replanner)
    loop.begin(TimedPlan(problem, solution, 0.0))
    return loop


def momentum(problem: PendulumSwingUp, states: Array) -> float:
    """Largest angular momentum about the pendulum's pivot along states (n, 4) [N m s]."""
    k = problem.plant.coefficients
    about = k.pendulum * states[:, 2] + k.arm * np.cos(states[:, 0]) * states[:, 3]
    return float(np.abs(about).max())


def swing_up(
    problem: PendulumSwingUp, solution: Solution, seed: int, push: float
) -> dict[str, Any]:
    """One swing-up, pushed half-way by `push` N m s; returns what was reached."""
    tracker = tracker_of(problem, rate=1.0 / PENDULUM_INTERVAL)
    assert isinstance(tracker, PendulumTracker)
    given = tracker.parameters

    def replanner(plan: TimedPlan) -> Replanner:
        return Replanner(SwingUpExecution(plan, given), REVIEWS)

    loop = loop_of(problem, solution, PENDULUM_INTERVAL, seed, replanner)
    tracker, plant = loop.vehicles[PENDULUM_NAME]
    true_plant = mismatched(problem.plant, MISMATCH, seed)
    impulse = push * np.random.default_rng([seed, 7]).choice([-1.0, 1.0])
    states, phases = [], []
    for tick in range(round(HELD_UNTIL / PENDULUM_INTERVAL)):
        if tick == round(0.5 * solution.duration / PENDULUM_INTERVAL):
            plant.push(partial(pendulum_push, true_plant, impulse=impulse))
        loop.tick()
        states.append(plant.state)
        phases.append(tracker.phase)
    angle = np.abs(wrapped(np.array(states)[:, 0]))
    away = np.flatnonzero(angle > HELD_ANGLE)
    upright_since = PENDULUM_INTERVAL * (float(away[-1]) + 1.0) if away.size else 0.0
    first = phases.index(Phase.HOLDING) if Phase.HOLDING in phases else len(phases) - 1
    return {
        'at_once': set(phases[first:]) == {Phase.HOLDING} and upright_since < HELD_FROM,
        'held': upright_since < HELD_FROM,
        'upright_since': upright_since,
        'disk': float(np.abs(np.array(states)[:, 1]).max()),
        **_planned(loop),
    }


def _planned(loop: RecedingHorizon) -> dict[str, Any]:
    times = [review.solve_time for review in loop.reviews if review.solve_time > 0.0]
    return {'plans': len(loop.plans), 'rejected': len(loop.rejections), 'times': times}


def pendulum(push: float, seeds: int) -> dict[str, Any]:
    """Swing up and catch, pushed by a share `push` of the swing's largest momentum."""
    problem = build(PendulumSwingUp, {'limits.torque': TORQUE, 'torque_reserve': RESERVE})
    solution = problem.solve(deadline=2.0)
    impulse = push * momentum(problem, solution.trajectory.states)
    what = f'pendulum, pushed by {push:.0%}' if push else 'pendulum'
    runs = [swing_up(problem, solution, seed, impulse) for seed in counted(range(seeds), what)]
    return {
        'runs': seeds,
        'at_once': sum(run['at_once'] for run in runs),
        'held': sum(run['held'] for run in runs),
        'slowest': max(run['upright_since'] for run in runs),
        'disk_worst': max(run['disk'] for run in runs),
        'disk_kept': sum(run['disk'] <= DISK_ANGLE for run in runs),
        **_figures(runs),
    }


def _figures(runs: list[dict[str, Any]]) -> dict[str, Any]:
    times = [time for run in runs for time in run['times']] or [0.0]
    return {
        'plans_mean': float(np.mean([run['plans'] for run in runs])),
        'plans_most': max(run['plans'] for run in runs),
        'rejected': sum(run['rejected'] for run in runs),
        'review_median_ms': 1e3 * float(np.median(times)),
        'review_worst_ms': 1e3 * max(times),
    }


def moved(problem: RobotFormation, rng: np.random.Generator) -> RobotFormation:
    """Return the same problem with the formation somewhere else, inside the arena."""
    while True:
        shift = rng.uniform(-0.5, 0.5, 3)
        anchor = (np.array(problem.formation.anchor) + shift).tolist()
        try:
            return replace(problem, formation=replace(problem.formation, anchor=anchor))
        except InvalidProblem:
            continue


def formation(seed: int, pushed: bool) -> dict[str, Any]:
    """One crossing, with a robot pushed or else the goal moved half-way."""
    changes = {'arena.tracking_margin': PUSH_MARGIN} if pushed else {}
    problem = crossing_of('quick robots', seed, **changes)
    solution = problem.solve(deadline=2.0)

    def replanner(plan: TimedPlan) -> Replanner:
        return Replanner(FormationExecution(plan), REVIEWS)

    loop = loop_of(problem, solution, ROBOT_INTERVAL, seed, replanner)
    rng = np.random.default_rng([seed, 7])
    ways, half_way = [], 0.5 * solution.duration
    while loop.time < loop.plans[-1].end + SETTLING and loop.time < problem.solver.longest:
        if loop.time - ROBOT_INTERVAL < half_way <= loop.time:
            if pushed:
                robot = list(loop.vehicles.values())[rng.integers(len(loop.vehicles))]
                direction = rng.uniform(-math.pi, math.pi)
                impulse = ROBOT_PUSH * problem.plant.mass
                robot.plant.push(
                    partial(robot_push, problem.plant, impulse=impulse, direction=direction)
                )
            else:
                loop.problem = moved(problem, rng)
        loop.tick()
        ways.append([vehicle.plant.state[:2] for vehicle in loop.vehicles.values()])
    places = np.array(ways)
    i, j = np.triu_indices(places.shape[1], 1)
    goals = np.array([p.states[-1, :2] for p in loop.plans[-1].solution.trajectories.values()])
    assert isinstance(loop.problem, RobotFormation)
    reached = np.abs(goals - loop.problem.task.goal).max() < ARRIVED
    count = round(AT_GOAL / ROBOT_INTERVAL)
    last = places[-count:]
    return {
        'arrived': bool(reached and np.linalg.norm(last - goals, axis=2).max() < ARRIVED),
        'separation': float(np.linalg.norm(places[:, i] - places[:, j], axis=-1).min()),
        'late': loop.plans[-1].end - solution.duration,
        **_planned(loop),
    }


def robots(pushed: bool, seeds: int) -> dict[str, Any]:
    """Crossings of three robots, one pushed or the goal moved half-way."""
    what = 'robots, one pushed' if pushed else 'robots, the goal moves'
    runs = [formation(seed, pushed) for seed in counted(range(seeds), what)]
    return {
        'runs': seeds,
        'arrived': sum(run['arrived'] for run in runs),
        'separated': sum(run['separation'] >= MINIMUM_SEPARATION for run in runs),
        'separation_least': min(run['separation'] for run in runs),
        'late_median': float(np.median([run['late'] for run in runs])),
        **_figures(runs),
    }


def run(seeds: int = 40) -> dict[str, Any]:
    """Measure everything."""
    return {
        'pendulum': {
            'model errors and noise': pendulum(0.0, seeds),
            'and a push half-way': pendulum(PUSH, seeds),
        },
        'robots': {
            'quick robots, one is pushed': robots(True, seeds),
            'quick robots, the goal moves': robots(False, seeds),
        },
    }


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    planning = f'{"plans mean, most":>18}{"rejected":>9}{"review ms med, max":>20}'
    lines = [
        f'{"pendulum":34}{"at once":>9}{"in 10 s":>9}{"slowest":>9}{"|psi| kept":>12}' + planning
    ]
    for name, f in figures['pendulum'].items():
        shares = [f'{f[key]}/{f["runs"]}' for key in ('at_once', 'held', 'disk_kept')]
        lines.append(
            f'{name:34}{shares[0]:>9}{shares[1]:>9}{f["slowest"]:8.2f}s{shares[2]:>12}' + _row(f)
        )
    lines.append(
        f'\n{"robots":34}{"arrived":>9}{"apart":>9}{"nearest":>9}{"later by":>12}' + planning
    )
    for name, f in figures['robots'].items():
        shares = [f'{f[key]}/{f["runs"]}' for key in ('arrived', 'separated')]
        lines.append(
            f'{name:34}{shares[0]:>9}{shares[1]:>9}{f["separation_least"]:8.3f}m'
            f'{f["late_median"]:11.2f}s' + _row(f)
        )
    return '\n'.join(lines)


def _row(f: dict[str, Any]) -> str:
    return (
        f'{f["plans_mean"]:12.1f}{f["plans_most"]:6d}{f["rejected"]:9d}'
        f'{f["review_median_ms"]:13.1f}{f["review_worst_ms"]:7.1f}'
    )

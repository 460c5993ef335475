# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
How quick replanning is; its deadlines, its memory, the rate of commands meanwhile.

Replans start from states along a plan that is under way, off by what tracking leaves; warm ones
from the rest of that plan. With a deadline of 30 ms every replan's overrun is measured, in wall
time and in processor time (on a machine that does other things besides, only the latter tells of
the program). Last, planner, tracker and plant run as nodes; the pendulum is pushed again and
again, so that plans are made at 5 Hz, and the periods between the tracker's commands are measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import gc
import math
from pathlib import Path
import tempfile
from typing import Any

from benchmark.measuring import counted, report, resident, timed
from benchmark.pendulum import REGIMES
from benchmark.scenarios import crossing
import numpy as np
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.pendulum.task import PendulumStart
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning.execution import Observation, TimedPlan
from tdm_planner.replanning.formation_execution import FormationExecution
from tdm_planner.tracking.motion import ObservedPhase

DEADLINE, LATE = 0.03, 0.01  # s
LONGEST = 0.25  # s that a replan may take where times are measured
# What tracking leaves, as standard deviations.
PENDULUM_AWAY = np.array([0.02, 0.02, 0.2, 0.2])
ROBOT_AWAY = np.array([0.004, 0.004, 0.003, 0.003, 0.01, 0.01, 0.0])
CROSSINGS = 10
FIRST_MEMORY = 100  # replans after which memory is looked at first


# Of a seed: a problem to be solved on the way, and the rest of the active plan.
Cases = Callable[[int], tuple[Problem, Solution | None]]


def pendulum_cases(torque: float) -> Cases:
    """Cases along one swing-up from hanging, up to 70 % of the way."""
    problem = build(PendulumSwingUp, {'limits.torque': torque})
    problem.prepare()
    plan = TimedPlan(problem, problem.solve(deadline=2.0), 0.0)
    motion = plan.solution.trajectory

    def case(seed: int) -> tuple[Problem, Solution | None]:
        rng = np.random.default_rng(seed)
        elapsed = rng.uniform(0.0, 0.7) * motion.duration
        state = motion.sample(elapsed).state + PENDULUM_AWAY * rng.normal(size=4)
        moved = replace(problem, start=PendulumStart(*state.tolist()))
        return moved, plan.remainder(elapsed)

    return case


def robot_cases() -> Cases:
    """Cases along crossings of three robots, between 5 and 75 % of the way."""
    plans, executions = [], []
    for seed in range(CROSSINGS):
        problem = RobotFormation.from_parameters(crossing(seed).parameters())
        plans.append(TimedPlan(problem, problem.solve(deadline=2.0), 0.0))
        executions.append(FormationExecution(plans[-1]))

    def case(seed: int) -> tuple[Problem, Solution | None]:
        rng = np.random.default_rng(seed)
        plan, execution = plans[seed % CROSSINGS], executions[seed % CROSSINGS]
        elapsed = rng.uniform(0.05, 0.75) * plan.solution.duration
        seen = {
            name: Observation(
                motion.sample(elapsed).state + ROBOT_AWAY * rng.normal(size=7),
                elapsed,
                ObservedPhase.FOLLOWING,
            )
            for name, motion in plan.solution.trajectories.items()
        }
        predicted = execution.predict(seen, elapsed)
        assert isinstance(plan.problem, RobotFormation)
        return execution.problem_from(plan.problem, predicted), plan.remainder(elapsed)

    return case


def solved(
    cases: Cases, seed: int, deadline: float, warm: bool = True
) -> tuple[float, float, bool]:
    """Solve the case of a seed: wall time, processor time [s], and whether there is a plan."""
    problem, rest = cases(seed)
    run = timed(problem, deadline, seed=seed, warm_start=rest if warm else None)
    return run.wall, run.processor, run.plan is not None


def latency(cases: Cases, count: int, warm: bool) -> dict[str, Any]:
    """Return the times of `count` replans."""
    found = [solved(cases, k, LONGEST, warm) for k in range(count)]
    wall, processor, planned = np.array(found).T
    return {
        'replans': count,
        'planned': int(planned.sum()),
        **{f'p{p}_ms': 1e3 * float(np.quantile(wall, p / 100)) for p in (50, 95, 99)},
        'worst_ms': 1e3 * float(wall.max()),
        'processor_p50_ms': 1e3 * float(np.median(processor)),
        'processor_p99_ms': 1e3 * float(np.quantile(processor, 0.99)),
    }


def overruns(kinds: dict[str, Cases], count: int) -> dict[str, Any]:
    """Return how late `count` replans or more ended after a deadline of 30 ms; their memory."""
    rounds = math.ceil(count / len(kinds))
    found, memory = [], resident()
    for k in counted(range(rounds), f'rounds of {len(kinds)} replans with a deadline'):
        found += [solved(cases, k, DEADLINE) for cases in kinds.values()]
        if len(found) - len(kinds) < FIRST_MEMORY <= len(found):
            memory = resident()
    wall, processor, planned = np.array(found).T
    late = wall - DEADLINE
    return {
        'replans': len(found),
        'planned': int(planned.sum()),
        'late': int((late > LATE).sum()),
        'late_by_processor_time': int((processor - DEADLINE > LATE).sum()),
        'p99_late_ms': 1e3 * float(np.quantile(late, 0.99)),
        'worst_late_ms': 1e3 * float(late.max()),
        'worst_processor_ms': 1e3 * float(processor.max()),
        'memory_after_100_mb': memory,
        'memory_mb': resident(),
    }


def command_stream(seconds: float) -> dict[str, Any]:
    """Return the periods of the tracker's commands while plans are made at 5 Hz."""
    from benchmark.nodes import PUSHED, Rig  # whose messages would count as memory of replans

    report(f'commands, for {seconds:g} s')
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig('pendulum', PUSHED, Path(folder))
        try:
            rig.begin()
            periods, plans = rig.measure(seconds)
        finally:
            rig.close()
    error = np.abs(periods - 5.0)
    return {
        'commands': len(error),
        'plans': plans,
        **{f'p{p}_ms': float(np.quantile(error, p / 100)) for p in (50, 95, 99)},
        'worst_ms': float(error.max()),
    }


def run(
    warm_replans: int = 1000,
    cold_replans: int = 300,
    replans: int = 10_000,
    seconds: float = 30.0,
) -> dict[str, Any]:
    """Measure everything: `replans` with a deadline, commands for `seconds` (0: without nodes)."""
    report('the plans that are under way')
    pendulums = {f'pendulum {name}': pendulum_cases(torque) for name, torque in REGIMES.items()}
    kinds = {**pendulums, 'three robots': robot_cases()}
    gc.freeze()  # as the planner node does once it is ready
    # First, for its memory: after it the process would have done all its growing.
    figures: dict[str, Any] = {'overruns': overruns(kinds, replans)}
    report('warm replans')
    warm = {f'{k}, warm': latency(cases, warm_replans, True) for k, cases in kinds.items()}
    report('cold replans')
    cold = {f'{k}, cold': latency(cases, cold_replans, False) for k, cases in pendulums.items()}
    figures['latency'] = warm | cold
    if seconds:
        figures['stream'] = command_stream(seconds)
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    lines = [
        f'{"replan [ms]":26}{"planned":>10}{"p50":>8}{"p95":>8}{"p99":>8}{"worst":>8}'
        f'{"processor p50, p99":>22}'
    ]
    for name, f in figures['latency'].items():
        planned = f'{f["planned"]}/{f["replans"]}'
        times = ''.join(f'{f[key]:8.1f}' for key in ('p50_ms', 'p95_ms', 'p99_ms', 'worst_ms'))
        lines.append(
            f'{name:26}{planned:>10}{times}{f["processor_p50_ms"]:14.1f}'
            f'{f["processor_p99_ms"]:8.1f}'
        )
    f = figures['overruns']
    lines.append(
        f'deadline {1e3 * DEADLINE:g} ms, {f["replans"]} replans ({f["planned"]} planned): '
        f'{f["late"]} later than {1e3 * LATE:g} ms after it (p99 {f["p99_late_ms"]:.1f} ms, worst '
        f'{f["worst_late_ms"]:.1f} ms); by processor time {f["late_by_processor_time"]}, longest '
        f'{f["worst_processor_ms"]:.1f} ms'
    )
    lines.append(
        f'resident memory: {f["memory_after_100_mb"]:.1f} MB after {FIRST_MEMORY} replans, '
        f'{f["memory_mb"]:.1f} MB after {f["replans"]}'
    )
    if 'stream' in figures:
        f = figures['stream']
        lines.append(
            f'commands at 200 Hz while {f["plans"]} plans were made: error of the period p50 '
            f'{f["p50_ms"]:.2f}, p95 {f["p95_ms"]:.2f}, p99 {f["p99_ms"]:.2f}, worst '
            f'{f["worst_ms"]:.2f} ms ({f["commands"]} commands)'
        )
    return '\n'.join(lines)

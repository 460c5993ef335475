# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Faults put into the solvers, each of a drawn size: what leaves them must be right still.

replays.py tells what is wrong with the plans, as they are written to files, by its own equations.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from replays import faults
from tdm_planner.direct_method.trust_region import TrustRegionOptions
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import PendulumSwingUp, Problem, RobotFormation, Solution
from tdm_planner.problems.direct import minima as direct_minima
from tdm_planner.problems.formation import search as formation_search
from tdm_planner.problems.pendulum import candidates
from tdm_planner.problems.pendulum.task import SwingUpTask
from tdm_planner.trajectory import to_nanoseconds, Trajectory

Patch = pytest.MonkeyPatch
Generator = np.random.Generator


def _minimisers(patch: Patch, change: Callable[..., Any]) -> None:
    """Put `change(right, program, xi, options, budget)` in the place of every minimiser."""
    for module in (candidates, direct_minima, formation_search):

        def minimise(program, xi, options=None, budget=None, right=module.minimise):
            return change(right, program, xi, options, budget)

        patch.setattr(module, 'minimise', minimise)


def early_stops(patch: Patch, rng: Generator, size: float) -> None:
    """Make the minimiser end after a few steps and say that it has converged."""

    def hasty(right: Any, program: Any, xi: Any, options: Any, budget: Any) -> Any:
        few = (options or TrustRegionOptions())._replace(iterations=int(rng.integers(1, 6)))
        return replace(right(program, xi, few, budget), converged=True)

    _minimisers(patch, hasty)


def noise_on_parameters(patch: Patch, rng: Generator, size: float) -> None:
    """Exchange the varied parameters Xi that the minimiser gives back."""

    def noisy(right: Any, program: Any, *others: Any) -> Any:
        found = right(program, *others)
        bounds = getattr(program, 'lower', 0.0), getattr(program, 'upper', np.inf)
        xi = found.point.xi * (1.0 + size * rng.normal(size=found.point.xi.shape))
        return replace(found, point=replace(found.point, xi=np.clip(xi, *bounds)))

    _minimisers(patch, noisy)


def _formations(patch: Patch, change: Callable[[Any], Any]) -> None:
    check = formation_search.assessed

    def assessed(task: Any, settings: Any, motions: Any, *others: Any) -> Solution:
        return check(task, settings, change(motions), *others)

    patch.setattr(formation_search, 'assessed', assessed)


def _scale(rng: Generator, size: float, values: np.ndarray) -> np.ndarray:
    return values * (1.0 + size * rng.choice([-1.0, 1.0]))


CHANGES = {
    'scaled_controls': lambda g, s, t: replace(t, controls=_scale(g, s, t.controls)),
    'scaled_durations': lambda g, s, t: replace(t, times=to_nanoseconds(_scale(g, s, t.times))),
    'shifted_states': lambda g, s, t: replace(t, states=g.normal(t.states, s)),
}  # fmt: skip


def sabotaged(change: Callable[..., Any], patch: Patch, rng: Generator, size: float) -> None:
    """Change every trajectory before it is checked."""
    check = SwingUpTask.plan

    def changed(t: Trajectory) -> Trajectory:
        return replace(change(rng, size, t), rates=None)

    def plan(self: Any, trajectory: Trajectory, *others: Any) -> Any:
        made = changed(trajectory).with_rates(self.plant.derivative)
        return check(self, made, *others)

    patch.setattr(SwingUpTask, 'plan', plan)
    _formations(patch, lambda motions: {name: changed(t) for name, t in motions.items()})


SABOTEURS: dict[str, Callable[[Patch, Generator, float], None]] = {
    'nothing': lambda patch, rng, size: None,
    'early_stops': early_stops,
    'noise_on_parameters': noise_on_parameters,
    **{name: partial(sabotaged, change) for name, change in CHANGES.items()},
}
SIZES = 1e-8, 0.3  # of sabotage


def _logarithmic(rng: Generator, least: float, most: float) -> float:
    return float(np.exp(rng.uniform(math.log(least), math.log(most))))


def pendulum(rng: Generator) -> Problem:
    """Any start, motors weak and strong, narrow and wide limits, every method."""
    angle = rng.uniform(0.6, 3.0)
    values = {
        'limits.torque': _logarithmic(rng, 0.015, 0.3), 'limits.disk_angle': angle,
        'torque_reserve': float(rng.choice([0.0, 0.3])),
        'start.theta': rng.uniform(-7.0, 7.0), 'start.psi': rng.uniform(-0.5, 0.5) * angle,
        'start.theta_dot': rng.normal() * 2.0, 'start.psi_dot': rng.normal(),
        'method': str(rng.choice(['switching'] * 3 + ['smooth', 'virtual_arc'])),
        'goal.turns': None if rng.uniform() < 0.8 else int(rng.integers(-1, 2)),
        'solver.deadline': 0.15,
    }  # fmt: skip
    return PendulumSwingUp.from_parameters(values)


def robots(rng: Generator) -> Problem:
    """One to three robots, at rest or not, sluggish and brisk, with and without zones."""
    names = [f'robot{k + 1}' for k in range(int(rng.integers(1, 4)))]
    values: dict[str, Any] = {
        'robots': names, 'formation.anchor': [2.0, 2.0, rng.uniform(-3.0, 3.0)],
        'limits.thrust': _logarithmic(rng, 0.3, 30.0),
        'limits.thruster_rate': _logarithmic(rng, 0.5, 10.0),
        'arena.tracking_margin': float(rng.choice([0.0, 0.03])),
        'weights.gas': float(rng.choice([0.0, 0.9])),
        'speed_factor_order': int(rng.choice([0, 0, 2])),
        'solver.deadline': 0.3, 'solver.starts': 2,
    }  # fmt: skip
    for name in names:
        values |= {f'{name}.start.{axis}': rng.uniform(0.4, 3.6) for axis in 'xy'}
        values[f'{name}.start.yaw'] = rng.uniform(-3.0, 3.0)
        if rng.uniform() < 0.3:
            values |= {f'{name}.start.{axis}': 0.05 * rng.normal() for axis in ('u', 'v', 'omega')}
    if rng.uniform() < 0.3:
        values['arena.obstacles'] = [*rng.uniform(1.0, 3.0, size=2).tolist(), 0.2]
    return RobotFormation.from_parameters(values)


PROBLEMS = {'pendulum': pendulum, 'robots': robots}


def published(kind: str, seed: int, attempts: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Plans that leave solvers, each sabotaged in another way, as they are written to files."""
    rng = np.random.default_rng(seed)
    for _ in range(attempts):
        try:
            problem = PROBLEMS[kind](rng)
        except InvalidProblem:
            continue
        name = list(SABOTEURS)[rng.integers(len(SABOTEURS))]
        size = _logarithmic(rng, *SIZES)
        with pytest.MonkeyPatch.context() as patch:
            SABOTEURS[name](patch, rng, size)
            try:
                solution = problem.solve(seed=int(rng.integers(1000)))
            except Infeasible:
                continue
        text = json.dumps(plan_document(problem, solution), allow_nan=False)
        yield f'{name} of {size:.2g}', json.loads(text)


def replayed_faults(kind: str, seed: int, wanted: int) -> list[Any]:
    """Replay so many published plans; return what is wrong, each with its document."""
    plans = list(itertools.islice(published(kind, seed, 50 * wanted), wanted))
    assert len(plans) == wanted
    return [(how, found, plan) for how, plan in plans if (found := faults(plan))]

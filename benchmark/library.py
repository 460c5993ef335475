# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The direct method as a library: speed of a problem that is only stated, its length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import importlib
import inspect
from pathlib import Path
import sys
import time
from types import ModuleType
from typing import Any

from benchmark.progress import report
import numpy as np
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes
from tdm_planner.problems import DirectSolverParameters

PLANTS = {
    'double_integrator': 'DoubleIntegrator',
    'brachistochrone': 'Brachistochrone',
    'obstacle': 'RoundTheObstacle',
    'landing': 'Landing',
    'pendulum': 'StatedSwingUp',
}
FOLDER = Path(__file__).parents[1] / 'docs' / 'plants'
_SECONDS = 1.0
_BATCH = 200
_DEADLINE = 10.0  # s, for plans


def run(
    free: Sequence[int] = (2, 3, 6, 9),
    intervals: Sequence[int] = (40, 80),
) -> dict[str, Any]:
    """
    Measure evaluations per second of the landing with 21 parameters, lines, and optimality.

    The landing is planned with `free` parameters an output, and by collocation on `intervals`.
    """
    sys.path.insert(0, str(FOLDER))
    modules = {module: importlib.import_module(module) for module in PLANTS}
    problems = {module: getattr(modules[module], name) for module, name in PLANTS.items()}
    landing = problems['landing'](free=6, speed_factor_order=2)
    program = Transcription(landing, chebyshev_nodes(41))
    program.begin(program.first_guess)
    xi = program.first_guess
    many = np.repeat(xi[None], _BATCH, axis=0)
    point = program.evaluate(xi)
    return {
        'parameters': program.size,
        'evaluations_per_second': _rate(lambda: program.evaluate(xi)),
        'batched_evaluations_per_second': _BATCH * _rate(lambda: program.motion(many)),
        'linearisations_per_second': _rate(lambda: program.linearise(point, None)),
        'lines': {
            module: len([line for line in inspect.getsource(kind).splitlines() if line.strip()])
            for module, kind in problems.items()
        },
        'double_integrator': _double_integrator(modules['double_integrator']),
        'brachistochrone': _brachistochrone(modules['brachistochrone']),
        'landing': _landing(modules['landing'], free, intervals),
    }


def _double_integrator(module: ModuleType) -> dict[int, float]:
    """Time over the optimum of 2 s, by the number of varied parameters."""
    report('double integrator')
    return {free + 1: t_f / 2.0 for free, t_f in module.table((0, 2, 4, 8, 12, 20)).items()}


def _brachistochrone(module: ModuleType) -> float:
    """Time over the cycloid's."""
    report('brachistochrone')
    problem = module.Brachistochrone(solver=DirectSolverParameters(deadline=_DEADLINE))
    best = module.cycloid_time(problem.across, problem.down, problem.gravity)
    return float(problem.solve().cost / best)


def _landing(module: ModuleType, free: Sequence[int], intervals: Sequence[int]) -> dict[str, Any]:
    """Return the performance index over that of collocation, by number of parameters."""
    report('landing')
    plans = module.table(free, (0, 2))
    costs = {plan.parameters.size: plan.cost for plan in plans.values()}
    reference = importlib.import_module('landing_reference')
    guess = plans[6 if 6 in free else free[0], 2].trajectory
    optima = [reference.collocation(module.Landing(), guess, n).cost for n in intervals]
    ratios = {size: costs[size] / optima[-1] for size in sorted(costs)}
    return {'ratio': ratios, 'reference': optima[-1], 'reference_half_grid': optima[0]}


def _rate(work: Callable[[], object]) -> float:
    """Repetitions per second of processor time."""
    began, count = time.process_time(), 0
    while time.process_time() - began < _SECONDS:
        work()
        count += 1
    return count / (time.process_time() - began)


def table(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    lines = [
        f'landing with {figures["parameters"]} varied parameters, 41 nodes, per second:',
        f'  evaluations one by one       {figures["evaluations_per_second"]:10.0f}',
        f'  evaluations in batches       {figures["batched_evaluations_per_second"]:10.0f}',
        f'  linearisations with Hessian  {figures["linearisations_per_second"]:10.0f}',
        'lines to state a problem:',
    ]
    lines += [f'  {name:28s} {count:10d}' for name, count in figures['lines'].items()]
    lines += ['double integrator, time over the optimum, by varied parameters:']
    lines += _rows(figures['double_integrator'])
    lines += [f'brachistochrone, time over the cycloid: {figures["brachistochrone"]:.6f}']
    landing = figures['landing']
    lines += [
        f'landing, J over collocation ({landing["reference"]:.5f}; with half the intervals '
        f'{landing["reference_half_grid"]:.5f}), by varied parameters:',
        *_rows(landing['ratio']),
    ]
    return '\n'.join(lines)


def _rows(values: dict[int, float]) -> list[str]:
    return [f'  {int(size):28d} {value:10.4f}' for size, value in values.items()]

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The direct method as a library: speed of a problem that is only stated, its length, overhead."""

from __future__ import annotations

from collections.abc import Callable
import importlib
import inspect
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np

from benchmark import overhead
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes
from tdm_planner.direct_method.transcription import Transcription

PLANTS = {
    'double_integrator': 'DoubleIntegrator',
    'brachistochrone': 'Brachistochrone',
    'obstacle': 'RoundTheObstacle',
    'landing': 'Landing',
}
FOLDER = Path(__file__).parents[1] / 'docs' / 'plants'
_SECONDS = 1.0
_BATCH = 200


def run() -> dict[str, Any]:
    """Measure evaluations per second of the landing with 21 parameters, and count lines."""
    sys.path.insert(0, str(FOLDER))
    problems = {
        module: getattr(importlib.import_module(module), name) for module, name in PLANTS.items()
    }
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
        'overhead': overhead.run(),
    }


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
    return '\n'.join([*lines, overhead.table(figures['overhead'])])

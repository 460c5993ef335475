# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What ``tdm check`` shows of a stated problem: its equations, limits, ends and speed."""

from __future__ import annotations

from timeit import timeit

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plant_views import StatedView
from tdm_planner.problems.direct.minima import DirectMinima
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem, misspelled_attributes
from tdm_planner.problems.direct.statement import (
    check_costs,
    check_statement,
    check_use,
    margins_at_ends,
    rates_of,
    short_of_reserve,
    violations_at_ends,
)
from tdm_planner.problems.problem import Problem
from tdm_planner.tracking.stated_tracking import StatedTrackerParameters
from tdm_planner.tracking.tracked_plants import PLANT_NODE, with_parameters_of

_REPEATED = 20  # evaluations that are timed
_WRONG = 'bold red'


@np.errstate(all='ignore')
def check_problem(problem: Problem, console: Console | None = None) -> list[str]:
    """
    Trace everything that a problem states, compare it, and print what was found.

    Return what is wrong, a sentence each; none if the statement can be planned for. Raise
    InvalidProblem for what cannot be traced, or does not fit together.
    """
    if not isinstance(problem, DirectProblem):
        raise InvalidProblem(
            f"problem '{problem.name}' brings its own transcription: only a DirectProblem states "
            'equations that can be checked'
        )
    console = console or Console(quiet=True, markup=False)
    check_statement(problem)
    StatedView(problem).check_drawing()
    plant, rng = DirectPlant(problem), np.random.default_rng(1)
    check_use(plant.trace)
    minima = DirectMinima(plant, problem.solver.tolerance, Budget(np.inf), rng)
    stated, program, xi = plant.stated, minima.rough, minima.changed
    ends = plant.ends
    limits = margins_at_ends(plant)
    check_costs(plant.trace, program.motion(xi), plant.numbers)

    reasons = _compare_rates(program, xi, console)
    table = Table('', 'at the start', 'at the end')
    names = (*stated.state_names, *stated.control_names)
    given = np.concatenate([ends.states, ends.controls], axis=1).T
    for name, pair_of in zip(names, given, strict=True):
        table.add_row(name, *(f'{v:.6g}' if np.isfinite(v) else 'free' for v in pair_of))
    console.print(table)
    if ends.unkept:
        console.print(
            'plans are not refined by collocation, and dearer for it, as these boundary '
            f'conditions fix neither a state nor a control: {", ".join(ends.unkept)}; state them '
            'in start_conditions or end_conditions if they are of states, else leave them out',
            style=_WRONG,
        )
    for function in (plant.trace.start_conditions, plant.trace.end_conditions):
        if count := function.numel_out(0):
            console.print(f'{function.name()}: {count} beside these')
    table = Table('limit', 'margin at the start', 'at the end')
    for name, values in limits.items():
        if values != (None, None):
            table.add_row(name, *('not fixed' if v is None else f'{v:.4g}' for v in values))
    if table.row_count:
        console.print(table)
    if free := [name for name, values in limits.items() if values == (None, None)]:
        console.print(f'limits whose margin is fixed at neither end: {"; ".join(free)}')
    for doubt in misspelled_attributes(type(problem)).values():
        console.print(doubt, style=_WRONG)
    if program.trace.fixed:
        console.print(
            'constants of the traced functions, for `if`, math or float on them; to change one '
            'traces the problem again: ' + ', '.join(program.trace.fixed)
        )
    if program.size:
        point = program.evaluate(xi)
        one = timeit(lambda: program.evaluate(xi), number=_REPEATED) / _REPEATED
        both = timeit(lambda: program.derivatives(point, None), number=_REPEATED) / _REPEATED
        console.print(
            f'one evaluation of a motion takes {1e3 * one:.3f} ms, with gradient and Hessian '
            f'{1e3 * both:.3f} ms'
        )
    else:
        console.print(
            'nothing is varied: no output has `free` parameters, and the duration is fixed'
        )
    try:
        with_parameters_of(StatedTrackerParameters, type(problem), taken=PLANT_NODE)
    except InvalidProblem as error:
        reasons.append(str(error))
    for doubt in short_of_reserve(stated, limits, 'end'):  # where there may be a plan all the same
        console.print(doubt, style=_WRONG)
    reasons += violations_at_ends(plant, limits)
    return reasons + short_of_reserve(stated, limits, 'start')


def _compare_rates(program: Transcription, xi: np.ndarray, console: Console) -> list[str]:
    """Print every state's rates at one node; return which are wrong."""
    table = Table('state', 'rate by invert', 'rate by derivative', '')
    states, reasons = program.formulation.state_names, []
    for state, inverse, rate, wrong in zip(states, *rates_of(program, xi), strict=True):
        compared = f'{inverse:.6g}', Text('differ', _WRONG) if wrong else 'agree'
        if state in program.integrated:
            compared = '-', 'integrated: not compared'
        table.add_row(state, compared[0], f'{rate:.6g}', compared[1])
        if wrong:
            reasons.append(
                f"derivative gives the rate of '{state}' = {rate:.6g}, the states of invert "
                f'change by {inverse:.6g}: one of the two is wrong'
            )
    console.print(table)
    return reasons

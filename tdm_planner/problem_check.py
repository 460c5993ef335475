# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What ``tdm check`` shows of a stated problem: its equations, limits, ends and speed."""

from __future__ import annotations

from dataclasses import dataclass
import time

import numpy as np
from rich.console import Console
from rich.table import Table
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.direct_method.transcription import Transcription
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plant_views import StatedView
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.problems.direct.statement import (
    check_ends,
    check_statement,
    rates_of,
    short_of_reserve,
)
from tdm_planner.problems.problem import Problem

_NODES, _REPEATED = 25, 20


@dataclass(frozen=True)
class Compared:
    """
    A state's rate by `invert` and by `derivative`, at the node where they differ most.

    That of a state which is `integrated` is taken from `derivative` alone: nothing is compared.
    """

    state: str
    by_inverse: float
    rate: float
    agrees: bool
    integrated: bool


@dataclass(frozen=True)
class Checked:
    """
    What was found of a statement.

    `rates` compares the equations; `limits` what is left to every limit at the start, None where
    that depends on what is free, `short` of which it is less than the reserve; `ends` what is
    given at the start and at the end, by name, NaN where it is free; `seconds` what one evaluation
    of a motion takes, and one with first and second derivatives.
    """

    rates: tuple[Compared, ...]
    limits: dict[str, float | None]
    short: list[str]
    ends: dict[str, tuple[float, float]]
    baked: tuple[str, ...]
    seconds: tuple[float, float]

    @property
    def reasons(self) -> list[str]:
        """Return what is wrong, a sentence each; none if the statement can be planned for."""
        found = [
            f"derivative gives the rate of '{row.state}' = {row.rate:.6g}, the states of invert "
            f'change by {row.by_inverse:.6g}: one of the two is wrong'
            for row in self.rates
            if not row.agrees
        ]
        found += [
            f"the start violates the limit '{name}' by {-value:.3g}"
            for name, value in self.limits.items()
            if value is not None and value < 0.0
        ]
        return found + self.short


def check_problem(problem: Problem) -> Checked:
    """
    Trace everything that a problem states, and compare it.

    Raise InvalidProblem for what cannot be traced, or does not fit together.
    """
    if not isinstance(problem, DirectProblem):
        raise InvalidProblem(
            f"problem '{problem.name}' brings its own transcription: only a DirectProblem states "
            'equations that can be checked'
        )
    check_statement(problem)
    pair = {name: np.zeros(2) + 0.1 * k for k, name in enumerate(problem.state_names)}
    StatedView(problem).drawing(pair, {})  # a report draws all instants at once
    stated = CheckedFormulation(problem)
    program = Transcription(problem, chebyshev_nodes(_NODES))
    program.begin(program.first_guess)
    ends = Ends.of(stated)
    names = (*stated.state_names, *stated.control_names)
    given = np.concatenate([ends.states, ends.controls], axis=1).T.tolist()
    rng = np.random.default_rng(1)
    xi = program.first_guess + 0.3 * rng.normal(size=program.size) / np.sqrt(program.size)
    by_inverse, rates, wrong = rates_of(program, xi)
    compared = []
    for index, state in enumerate(stated.state_names):
        gaps = np.nan_to_num(np.abs(by_inverse - rates)[:, index])
        node = int(np.argmax(gaps))
        values = float(by_inverse[node, index]), float(rates[node, index])
        alone = state in problem.integrated()
        compared.append(Compared(state, *values, agrees=not wrong[index], integrated=alone))
    limits = check_ends(stated, ends, refuse=False)
    return Checked(
        rates=tuple(compared),
        limits=limits,
        short=short_of_reserve(stated, limits),
        ends={name: (start, end) for name, (start, end) in zip(names, given, strict=True)},
        baked=tuple(program.trace.fixed),
        seconds=_timed(program, xi),
    )


def _timed(program: Transcription, xi: np.ndarray) -> tuple[float, float]:
    """Seconds of one evaluation, and of one linearisation."""
    point = program.evaluate(xi)
    began = time.perf_counter()
    for _ in range(_REPEATED):
        program.evaluate(xi)
    middle = time.perf_counter()
    for _ in range(_REPEATED):
        program.derivatives(point, None)
    return (middle - began) / _REPEATED, (time.perf_counter() - middle) / _REPEATED


def show(checked: Checked, console: Console) -> None:
    """Print tables of what was found."""
    table = Table('state', 'rate by invert', 'rate by derivative', '')
    for row in checked.rates:
        verdict = 'agree' if row.agrees else '[bold red]differ'
        verdict = 'integrated: not compared' if row.integrated else verdict
        table.add_row(row.state, f'{row.by_inverse:.6g}', f'{row.rate:.6g}', verdict)
    console.print(table)
    table = Table('', 'at the start', 'at the end')
    for name, given in checked.ends.items():
        table.add_row(name, *(f'{v:.6g}' if np.isfinite(v) else 'free' for v in given))
    console.print(table)
    if checked.limits:
        table = Table('limit', 'margin at the start')
        for name, value in checked.limits.items():
            left = 'depends on free values' if value is None else f'{value:.4g}'
            table.add_row(name, left)
        console.print(table)
    if checked.baked:
        console.print(
            'constants of the traced functions, for `if`, math or float on them; to change one '
            'traces the problem again: ' + ', '.join(checked.baked)
        )
    one, both = checked.seconds
    console.print(
        f'one evaluation of a motion takes {1e3 * one:.3f} ms, with gradient and Hessian '
        f'{1e3 * both:.3f} ms'
    )

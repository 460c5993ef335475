# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of the peers' figures, in Markdown, and their chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.peers.attempts import against, COLLOCATION_WARM, OURS, OURS_WARM, summary
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

_BLANK = '-'
_COLOURS = {
    'tdm_planner': '#0b5394',
    'tdm_planner, warm': '#6fa8dc',
    'collocation, straight line': '#e69138',
    'collocation, straight ways': '#e69138',
    'collocation, swing': '#cc0000',
    'collocation, roundabout': '#cc0000',
    'collocation, best of 3 guesses': '#741b47',
    'collocation, warm': '#ea9999',
}
_NEAR = {'3 robots': 1.06}  # of the best known cost; elsewhere 1.02


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table, its first column to the left, the others to the right."""
    rule = ['---', *['---:'] * (len(head) - 1)]
    return '\n'.join('| ' + ' | '.join(row) + ' |' for row in (head, rule, *rows))


def number(value: float | None, digits: int = 3) -> str:
    """Return a figure of a table, with `digits` that count."""
    if value is None or not np.isfinite(value):
        return _BLANK
    if value == 0 or abs(value) >= 10 ** (digits - 1):
        return f'{value:.0f}'
    return f'{value:.{digits}g}'


def share(value: float | None) -> str:
    """Return a share in percent."""
    return _BLANK if value is None else f'{100 * value:.0f} %'


def ratio(value: float | None) -> str:
    """Return a ratio of costs."""
    return _BLANK if value is None or not np.isfinite(value) else f'{value:.3f}'


def _known(problem: Mapping[str, Any]) -> dict[int, float]:
    """Best known costs by case."""
    return {int(case): cost for case, cost in problem['known'].items()}


def comparison(problem: Mapping[str, Any]) -> str:
    """Every solver of one problem."""
    known = _known(problem)
    attempts = problem['attempts']
    head = [
        'solver', 'cases', 'converged', 'solved', 'within 1.02', 'cost / best known', 'p95',
        'ms, median', 'p95', 'iterations', 'time / ours', 'cost / ours',
    ]  # fmt: skip
    order = sorted(attempts, key=lambda name: ('warm' in name, not name.startswith(OURS)))
    return markdown(head, [_solver(name, attempts, known) for name in order])


def _solver(name: str, attempts: Mapping[str, Any], known: Mapping[int, float]) -> list[str]:
    f = summary(attempts[name], known)
    relative = against(attempts[OURS_WARM if 'warm' in name else OURS], attempts[name])
    quality = [share(f['converged']), share(f['solved']), share(f['near'])]
    costs = [ratio(f['ratio_median']), ratio(f['ratio_p95'])]
    times = [number(f['ms_median']), number(f['ms_p95']), number(f['iterations'])]
    last = [number(relative['time'], 2), ratio(relative['cost'])]
    return [name, str(f['cases']), *quality, *costs, *times, *last]


def in_short(figures: Mapping[str, Any]) -> str:
    """Return one line a problem and kind of start: how often, how near, how quick."""
    lines = []
    for title, problem in figures['problems'].items():
        known = _known(problem)
        found = {name: summary(a, known) for name, a in problem['attempts'].items()}
        cold = [name for name in found if name.startswith('collocation') and 'warm' not in name]
        for kind, mine, theirs in (('cold', OURS, cold), ('warm', OURS_WARM, [COLLOCATION_WARM])):
            ours = found[mine]
            lines.append(
                f'- **{title}, {kind}**: this package solved {share(ours["solved"])} at a median '
                f'of {ratio(ours["ratio_median"])} of the best known cost in '
                f'{number(ours["ms_median"])} ms.'
            )
            for name in theirs:
                f = found[name]
                relative = against(problem['attempts'][mine], problem['attempts'][name])
                lines.append(
                    f'  - {name}: {share(f["solved"])} at {ratio(f["ratio_median"])}, '
                    f'{share(f["near"])} within 1.02 (this package {share(ours["near"])}), '
                    f'{pace(relative["time"])}.'
                )
    return '\n'.join(lines)


def pace(times: float | None) -> str:
    """Return how a time compares with ours, in words."""
    if times is None or not times > 0:
        return 'not timed'
    return f'{times:.2g} times slower' if times >= 1 else f'{1 / times:.2g} times quicker'


def sections(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Headings and tables."""
    found = []
    for name, problem in figures['problems'].items():
        program = (
            f'The program of the collocation has {problem["variables"]} variables; building it '
            f'and its derivatives took {problem["build_s"]:.2f} s, once, not counted above.'
        )
        found.append((name, f'{comparison(problem)}\n\n{program}'))
    return found


def table(figures: Mapping[str, Any]) -> str:
    """All tables, as text."""
    return '\n\n'.join(f'{heading}\n\n{body}' for heading, body in sections(figures))


def draw(figures: Mapping[str, Any], folder: Path) -> None:
    """Write the chart: share of the cases solved near the best known cost within a time."""
    problems = figures['problems']
    picture = Figure(figsize=(13, 5.2), layout='constrained')
    FigureCanvasAgg(picture)
    picture.subplots(1, len(problems), sharey=True)
    handles: dict[str, Any] = {}
    for axis, (title, problem) in zip(picture.axes, problems.items(), strict=True):
        near = _NEAR.get(title, 1.02)
        known = _known(problem)
        for name, colour in _COLOURS.items():
            if name not in problem['attempts']:
                continue
            attempts = [a for a in problem['attempts'][name] if a['case'] in known]
            good = [a for a in attempts if a['solved'] and a['cost'] <= near * known[a['case']]]
            times = np.sort([1e3 * a['seconds'] for a in good])
            shares = np.arange(1, times.size + 1) / max(len(attempts), 1)
            dashes = '--' if 'warm' in name else '-'
            (handles[name],) = axis.step(
                np.append(times, 1e5), np.append(shares, shares[-1:] if times.size else [0.0]),
                where='post', color=colour, linestyle=dashes, linewidth=2,
            )  # fmt: skip
        axis.set(xscale='log', xlim=(1, 1e4), ylim=(0, 1.02), xlabel='processor time [ms]')
        axis.set_title(f'{title}\nsolved at {near:g} of the best known cost or less', fontsize=10)
        axis.grid(alpha=0.3)
    picture.axes[0].set_ylabel('share of the cases')
    picture.legend(
        list(handles.values()), list(handles), loc='outside lower center', ncols=4, frameon=False
    )
    folder.mkdir(parents=True, exist_ok=True)
    picture.savefig(folder / 'benchmark_success.png', dpi=110)

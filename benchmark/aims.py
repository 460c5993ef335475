# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What the package aims at, beside what was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmark import explanations
from benchmark.peers.attempts import against, summary
from benchmark.peers.tables import COLLOCATION_WARM, markdown, OURS, OURS_WARM

Figures = Mapping[str, Any]
Judged = tuple[str, bool]  # what was measured, and whether that meets the aim

NOT_MEASURED = 'not measured'
_PENDULUM, _PUSHED = 'model errors and noise', 'and a push half-way'
_ROBOT_PUSHED, _GOAL_MOVES = 'quick robots, one is pushed', 'quick robots, the goal moves'
_STRONG, _WEAK, _ROBOTS = 'pendulum, strong torque', 'pendulum, weak torque', '3 robots'
_LINE, _BEST = 'collocation, straight line', 'collocation, best of 3 guesses'


@dataclass(frozen=True)
class Aim:
    """An aim, and how the figures of a section are judged by it."""

    text: str
    section: str
    judge: Callable[[Figures], Judged]

    def row(self, figures: Mapping[str, Figures]) -> list[str]:
        """Return the row of the table from the figures of all sections by name."""
        if self.section not in figures:
            return [self.text, NOT_MEASURED, '-']
        measured, met = self.judge(figures[self.section])
        return [self.text, measured, 'yes' if met else '**no**']


def table(figures: Mapping[str, Figures]) -> str:
    """Return all aims as a table in Markdown."""
    return markdown(['aim', 'measured', 'met'], [aim.row(figures) for aim in AIMS], 'l')


# Replanning: shares of the runs.


def _share(kind: str, run: str, key: str, least: float = 1.0) -> Callable[[Figures], Judged]:
    def judge(figures: Figures) -> Judged:
        f = figures[kind][run]
        return f'{f[key]} of {f["runs"]}', f[key] >= least * f['runs']

    return judge


def _apart(run: str) -> Callable[[Figures], Judged]:
    def judge(figures: Figures) -> Judged:
        f = figures['robots'][run]
        text = f'{f["separated"]} of {f["runs"]}, nearest {f["separation_least"]:.3f} m'
        return text, f['separated'] == f['runs']

    return judge


# Latency: the slowest kind decides.


def _times(kinds: Sequence[str], **most: float) -> Callable[[Figures], Judged]:
    """`most` milliseconds by quantile; `kinds` of replans, by their names in the table."""

    def judge(figures: Figures) -> Judged:
        texts, met = [], True
        for kind in kinds:
            f = figures['latency'][kind]
            found = [f'{f[f"{quantile}_ms"]:.1f}' for quantile in most]
            called = kind.partition(',')[0].removeprefix('pendulum ')
            texts.append(f'{" / ".join(found)} ms' + (f' ({called})' if len(kinds) > 1 else ''))
            met &= all(f[f'{quantile}_ms'] <= limit for quantile, limit in most.items())
        return ', '.join(texts), met

    return judge


def _deadline(figures: Figures) -> Judged:
    f = figures['overruns']
    text = (
        f'{f["late"]} of {f["replans"]:,} ({f["late_by_processor_time"]} by processor time), '
        f'the latest {f["worst_late_ms"]:.1f} ms after it'
    )
    return text, f['late'] == 0 and f['replans'] >= 10_000


def _stream(figures: Figures) -> Judged:
    if 'stream' not in figures:
        return NOT_MEASURED, False
    f = figures['stream']
    text = f'{f["p99_ms"]:.2f} ms, worst {f["worst_ms"]:.1f} ms, {f["plans"]} plans meanwhile'
    return text, f['p99_ms'] <= 5.0


def _memory(figures: Figures) -> Judged:
    f = figures['overruns']
    growth = f['memory_mb'] / f['memory_after_100_mb'] - 1.0
    text = f'{growth:+.1%} ({f["memory_after_100_mb"]:.0f} to {f["memory_mb"]:.0f} MB)'
    return text, abs(growth) <= 0.05 and f['replans'] >= 10_000


# Peers.


def _summary(problem: Figures, name: str) -> dict[str, Any]:
    known = {int(case): cost for case, cost in problem['known'].items()}
    return summary(problem['attempts'][name], known)


def _cold(problem: Figures) -> list[str]:
    """Names of the collocation's cold starts, the best of them last."""
    names = [
        n for n in problem['attempts'] if n.startswith('collocation') and n != COLLOCATION_WARM
    ]
    return sorted(names, key=lambda name: name == _BEST)


def _quicker(title: str, times: float, cost: float) -> Callable[[Figures], Judged]:
    """Whether every collocation takes so many times our time, and our cost is so near theirs."""

    def judge(figures: Figures) -> Judged:
        problem, texts, met = figures['problems'][title], [], True
        for name in [*_cold(problem), COLLOCATION_WARM]:
            mine = OURS_WARM if name == COLLOCATION_WARM else OURS
            found = against(problem['attempts'][mine], problem['attempts'][name])
            if found['time'] is None or found['cost'] is None:
                continue
            ratio = 1.0 / found['cost']
            called = name.removeprefix('collocation, ')
            texts.append(f'{found["time"]:.2g} x at {ratio:.3f} ({called})')
            met &= found['time'] >= times and ratio <= cost
        return ', '.join(texts) or 'nothing to compare with', met and bool(texts)

    return judge


def _solved(figures: Figures) -> Judged:
    texts, met = [], True
    for title in (_STRONG, _WEAK):
        problem = figures['problems'][title]
        ours, line = (_summary(problem, name)['solved'] for name in (OURS, _LINE))
        called = title.removeprefix('pendulum, ').removesuffix(' torque')
        texts.append(f'{called}: {ours:.0%} where collocation from a straight line {line:.0%}')
        met &= ours >= 0.99
    return '; '.join(texts), met


def _oftener(title: str) -> Callable[[Figures], Judged]:
    def judge(figures: Figures) -> Judged:
        problem = figures['problems'][title]
        ours = _summary(problem, OURS)['solved']
        theirs = {name: _summary(problem, name)['solved'] for name in _cold(problem)}
        named = ', '.join(
            f'{s:.0%} ({n.removeprefix("collocation, ")})' for n, s in theirs.items()
        )
        alike = ': as often' if ours == max(theirs.values()) else ''
        single = [share for name, share in theirs.items() if name != _BEST]
        return f'{ours:.0%} against {named}{alike}', ours > max(single)

    return judge


def _explained(figures: Figures) -> Judged:
    largest = [cost for cost in explanations.largest(figures) if cost.share >= explanations.LARGE]
    unexplained = [cost.label for cost in largest if not cost.text]
    if unexplained:
        return f'not explained: {", ".join(unexplained)}', False
    return 'explained under Profile', True


_BOTH = ('pendulum strong', 'pendulum weak')
_WARM, _COLD = ([f'{kind}, {how}' for kind in _BOTH] for how in ('warm', 'cold'))

AIMS = (
    Aim(
        'Pendulum, .02 N m, +-5 % mismatch and noise: held at the first catch in 36 of 40 or more',
        'replanning',
        _share('pendulum', _PENDULUM, 'at_once', 0.9),
    ),
    Aim('- held within 10 s in all', 'replanning', _share('pendulum', _PENDULUM, 'held')),
    Aim(
        "- pushed half-way by 30 % of the swing's peak momentum: at the first catch in 36 of 40 "
        'or more',
        'replanning',
        _share('pendulum', _PUSHED, 'at_once', 0.9),
    ),
    Aim('- pushed: held within 10 s in all', 'replanning', _share('pendulum', _PUSHED, 'held')),
    Aim(
        'Three robots, one pushed half-way by .05 m/s: all arrive, 40 of 40',
        'replanning',
        _share('robots', _ROBOT_PUSHED, 'arrived'),
    ),
    Aim('- the minimum separation is never violated', 'replanning', _apart(_ROBOT_PUSHED)),
    Aim(
        'Three robots, the goal changed half-way: all arrive, 40 of 40',
        'replanning',
        _share('robots', _GOAL_MOVES, 'arrived'),
    ),
    Aim('- the minimum separation is never violated', 'replanning', _apart(_GOAL_MOVES)),
    Aim('Replan of the pendulum, warm: p50 <= 10 ms', 'latency', _times(_WARM, p50=10.0)),
    Aim('- cold: p50 <= 100 ms', 'latency', _times(_COLD, p50=100.0)),
    Aim('- warm: p99 <= 300 ms', 'latency', _times(_WARM, p99=300.0)),
    Aim('- cold: p99 <= 300 ms', 'latency', _times(_COLD, p99=300.0)),
    Aim(
        'Replan of three robots, warm: p50 <= 15 ms',
        'latency',
        _times(['three robots, warm'], p50=15.0),
    ),
    Aim('- warm: p99 <= 60 ms', 'latency', _times(['three robots, warm'], p99=60.0)),
    Aim(
        'A deadline of 30 ms is exceeded by more than 10 ms in none of 10,000 replans',
        'latency',
        _deadline,
    ),
    Aim(
        'Commands at 200 Hz while plans are made at 5 Hz, two cores: p99 of the error of the '
        'period <= 5 ms',
        'latency',
        _stream,
    ),
    Aim(
        'Resident memory after 10,000 replans within 5 % of that after 100',
        'latency',
        _memory,
    ),
    Aim(
        'Pendulum, strong torque: 10 times quicker than collocation, or more, at the same t_f '
        'within 2 %',
        'peers',
        _quicker(_STRONG, 10.0, 1.02),
    ),
    Aim('- weak torque: the same', 'peers', _quicker(_WEAK, 10.0, 1.02)),
    Aim('- 99 % solved, or more, where cold collocation solves half', 'peers', _solved),
    Aim(
        'Three robots: 50 times quicker than collocation, or more, at J within 1.06',
        'peers',
        _quicker(_ROBOTS, 50.0, 1.06),
    ),
    Aim(
        'Solved more often than by collocation from a cold start: pendulum, strong torque',
        'peers',
        _oftener(_STRONG),
    ),
    Aim('- pendulum, weak torque', 'peers', _oftener(_WEAK)),
    Aim('- three robots', 'peers', _oftener(_ROBOTS)),
    Aim('The three largest costs removed or explained', 'profile', _explained),
)

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

"""Flame graphs: sampling the Python stack over processor time, and drawing what was sampled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
import signal
from types import FrameType, TracebackType

_INTERVAL = 1e-3  # s; the kernel may make it longer
_LEAST = 0.004  # share of the time below which a frame is not drawn
_WIDTH = 165  # letters

Stack = tuple[str, ...]


@dataclass(frozen=True)
class Frame:
    """A function, how many samples were taken in it or what it called, and what it called."""

    name: str
    samples: int
    children: tuple[Frame, ...]


class Sampler:
    """
    Counts the main thread's stacks, outermost first, at equal steps of processor time.

    The time counts whichever thread spends it: while others work, the main thread stands where it
    waits for them. Compiled code counts for the function that calls it.
    """

    def __init__(self) -> None:
        self.stacks: Counter[Stack] = Counter()

    def _take(self, number: int, frame: FrameType | None) -> None:
        names = []
        while frame is not None:
            code = frame.f_code
            names.append(f'{Path(code.co_filename).stem}.{code.co_name}')
            frame = frame.f_back
        self.stacks[tuple(reversed(names))] += 1

    def __enter__(self) -> Sampler:
        self._before = signal.signal(signal.SIGPROF, self._take)
        signal.setitimer(signal.ITIMER_PROF, _INTERVAL, _INTERVAL)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self._before)


def below(stacks: Counter[Stack], root: str) -> Counter[Stack]:
    """Return the stacks that hold the function `root`, from there on."""
    found: Counter[Stack] = Counter()
    for stack, count in stacks.items():
        if root in stack:
            first = stack.index(root)
            found[stack[first:]] += count
    return found


def tree(stacks: Counter[Stack], name: str) -> Frame:
    """Return the frames of stacks that all begin with `name`."""
    callees: dict[str, Counter[Stack]] = {}
    for stack, count in stacks.items():
        if len(stack) > 1:
            callees.setdefault(stack[1], Counter())[stack[1:]] += count
    children = tuple(tree(inner, callee) for callee, inner in sorted(callees.items()))
    return Frame(name, sum(stacks.values()), children)


def costs(stacks: Counter[Stack]) -> list[tuple[str, float]]:
    """Share of the samples of every function, with all it calls, largest first."""
    total = sum(stacks.values())
    found: Counter[str] = Counter()
    for stack, count in stacks.items():
        for name in set(stack):
            found[name] += count
    return [(name, count / total) for name, count in found.most_common()]


def boxes(frame: Frame, left: int = 0, level: int = 0) -> Iterator[tuple[Frame, int, int]]:
    """Every frame with its left edge, in samples, and its level."""
    yield frame, left, level
    for child in frame.children:
        yield from boxes(child, left, level + 1)
        left += child.samples


def draw(root: Frame, own: set[str], title: str, file: Path) -> None:
    """Draw a flame graph; the modules `own` are coloured. Width is time, callees stand above."""
    import matplotlib as mpl

    mpl.use('Agg')
    import matplotlib.pyplot as plt

    total = root.samples
    shown = [box for box in boxes(root) if box[0].samples > _LEAST * total]
    depth = 1 + max(level for _, _, level in shown)
    picture, axis = plt.subplots(figsize=(13, 0.28 * depth + 0.9), layout='constrained')
    for frame, left, level in shown:
        module, function = frame.name.split('.', 1)
        width, place = frame.samples / total, left / total
        shade = 0.12 * (_share(frame.name) - 0.5)
        colour = (0.95, 0.62 + shade, 0.3) if module in own else (0.8 + shade,) * 3
        axis.barh(level, width, left=place, height=0.94, align='center', color=colour, ec='white')
        letters = int(width * _WIDTH)
        if letters > 3:
            text = frame.name if module in own and len(frame.name) <= letters else function
            text = text if len(text) <= letters else f'{text:.{letters - 1}}…'
            axis.text(place + 0.002, level, text, va='center', fontsize=7.5)
    # Bars hang about their level from their left edge.
    axis.set(xlim=(0, 1), ylim=(-0.6, depth - 0.4), yticks=[], title=title)
    axis.set_xlabel('share of the time of solve()')
    file.parent.mkdir(parents=True, exist_ok=True)
    picture.savefig(file, dpi=110)
    plt.close(picture)


def _share(name: str) -> float:
    """Return a number in [0, 1), always the same for a name."""
    return math.modf(sum((i + 1) * ord(letter) for i, letter in enumerate(name)) * 0.618034)[0]

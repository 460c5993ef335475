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

"""Pictures of the nodes with what goes in and out, as SVG, from their topics and services."""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import escape

from tools.endpoints import Endpoint

_ROW, _TOP, _ARROW, _BOX, _LABEL = 26, 20, 36, 150, 190
_STYLE = (
    'text{font:13px ui-monospace,monospace;fill:#1f2937}'
    '.node{font:600 15px system-ui,sans-serif;fill:#fff}'
    '.box{fill:#1d4ed8}.line{stroke:#475569;stroke-width:1.4}.tip{fill:#475569}'
    '.service{stroke-dasharray:4 3}'
    '@media(prefers-color-scheme:dark){.paper{fill:#f8fafc}}'
)


def node_picture(name: str, endpoints: Iterable[Endpoint]) -> str:
    """
    Return the picture: what is taken to the left, what is given to the right of a box.

    Services are dashed; those that the node offers are to the left, those it calls to the right.
    """
    found = list(endpoints)
    left = [end for end in found if end.kind in ('service', 'subscribes')]
    right = [end for end in found if end.kind in ('publishes', 'calls')]
    rows = max(len(left), len(right), 2)
    width = 2 * (_LABEL + _ARROW) + _BOX
    height = rows * _ROW + 2 * _TOP
    middle = height / 2
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" role="img" aria-label="{name}: topics and services">',
        f'<style>{_STYLE}</style>',
        f'<rect class="paper" width="{width}" height="{height}" rx="8" fill="#f8fafc"/>',
        f'<rect class="box" x="{_LABEL + _ARROW}" y="{_TOP / 2}" width="{_BOX}" '
        f'height="{height - _TOP}" rx="8"/>',
        f'<text class="node" x="{width / 2}" y="{middle + 5}" text-anchor="middle">{name}</text>',
    ]
    for ends, x, anchor, begin in (
        (left, _LABEL - 6, 'end', _LABEL),
        (right, width - _LABEL + 6, 'start', _LABEL + _ARROW + _BOX),
    ):
        for index, end in enumerate(ends):
            y = middle + (index - (len(ends) - 1) / 2) * _ROW
            parts += _arrow(end, begin, y)
            parts.append(
                f'<text x="{x}" y="{y + 4:g}" text-anchor="{anchor}">{escape(end.name)}</text>'
            )
    return '\n'.join([*parts, '</svg>', ''])


def _arrow(end: Endpoint, x: float, y: float) -> list[str]:
    dashed = ' service' if end.kind in ('service', 'calls') else ''
    tip = x + _ARROW
    return [
        f'<line class="line{dashed}" x1="{x}" y1="{y:g}" x2="{tip - 7}" y2="{y:g}"/>',
        f'<path class="tip" d="M{tip} {y:g}l-8 -4v8z"/>',
    ]

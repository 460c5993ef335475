# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The architecture's figure, drawn from the imports: docs/images/architecture.svg.

Rooms are groups of modules, listed from the top. A module imports only from its own room and those
below, or there is no figure. An arrow that others imply is left away. Imports for type checking
alone count for nothing, and those inside of functions make no arrow.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# Room: what it does, and its modules, with all below them that no other room names.
ROOMS = {
    'commands': (
        'tdm, demo, live page, studies',
        'tdm_planner.cli tdm_planner.set_up tdm_planner.launching tdm_planner.robot_nodes '
        'tdm_planner.problem_check '
        'tdm_sim.demo tdm_sim.processes tdm_sim.live tdm_sim.study',
    ),
    'recorder, report': (
        'rosbag2 in, one HTML page out',
        'tdm_sim.report tdm_sim.recorder tdm_sim.bag_writer tdm_sim.progress',
    ),
    'simulated plants': ('nodes that integrate', 'tdm_sim'),
    'nodes': ('planner, tracker, client', 'tdm_planner.nodes tdm_planner.client'),
    'replanning': ('plants of the planner, reviews', 'tdm_planner.replanning'),
    'views': ('goals, limits, pictures', 'tdm_planner.plant_views'),
    'tracking': ('estimator and feedback laws', 'tdm_planner.tracking'),
    'problems': ('what is solved, and how', 'tdm_planner.problems tdm_planner.plan_files'),
    'verification': ('replay and dense check', 'tdm_planner.verification'),
    'plants': (
        'equations of motion, shapes',
        'tdm_planner.plants tdm_planner.plant_kind tdm_planner.drawing',
    ),
    'direct_method': ('reference functions, minimisers', 'tdm_planner.direct_method'),
    'foundation': ('trajectory, parameters, exceptions', 'tdm_planner'),
}
ORDER = {room: k for k, room in enumerate(ROOMS)}
WIDE, HIGH, ROW = 290, 50, 84  # px: from box to box, height of a box, from row to row


def room_of(module: str) -> str:
    """Return the room of a module."""
    rooms = {name: room for room, (_, names) in ROOMS.items() for name in names.split()}
    while module not in rooms:
        module = module.rpartition('.')[0]
    return rooms[module]


@cache
def imports() -> dict[tuple[str, str], bool]:
    """Return which module imports which of another room, and whether on being loaded."""
    paths = {
        '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
        for folder in ('tdm_planner', 'tdm_sim')
        for path in (ROOT / folder).rglob('*.py')
    }

    def found(node: ast.AST, loaded: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.Import, ast.ImportFrom)):
                above = f'{child.module}.' if isinstance(child, ast.ImportFrom) else ''
                for name in (above + alias.name for alias in child.names):
                    yield name if name in paths else above[:-1], loaded
            elif not (isinstance(child, ast.If) and 'TYPE_CHECKING' in ast.unparse(child.test)):
                yield from found(child, loaded and not isinstance(child, ast.FunctionDef))

    edges: dict[tuple[str, str], bool] = defaultdict(bool)
    for module, path in sorted(paths.items()):
        for other, loaded in found(ast.parse(path.read_text(encoding='utf-8')), True):
            if other in paths and room_of(other) != room_of(module):
                edges[module, other] |= loaded
    return edges


def check() -> None:
    """Raise SystemExit if a module imports from a room above its own."""
    for module, other in imports():
        if ORDER[room_of(other)] < ORDER[room_of(module)]:
            raise SystemExit(f'{module} imports {other}, of a room above (tools/architecture)')


def figure() -> str:
    """Return the figure as SVG; every room is in the row below the lowest that imports from it."""
    check()
    below: dict[str, set[str]] = {room: set() for room in ROOMS}
    for (module, other), loaded in imports().items():
        below[room_of(module)] |= {room_of(other)} if loaded else set()
    row: dict[str, int] = {}
    for room in ROOMS:
        row[room] = 1 + max((row[above] for above in row if room in below[above]), default=-1)
    rows = [[room for room in ROOMS if row[room] == k] for k in range(1 + max(row.values()))]
    wide = max(map(len, rows)) * WIDE
    middle = {
        r: (wide + (2 * i + 1 - len(rs)) * WIDE) // 2 for rs in rows for i, r in enumerate(rs)
    }
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {len(rows) * ROW}"'
        ' font-family="sans-serif" text-anchor="middle">',
        '<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8"'
        ' orient="auto"><path d="M0 0 8 4 0 8z" fill="#555"/></marker>',
        '<rect width="100%" height="100%" fill="#fff"/>',
    ]
    for room, (text, _) in ROOMS.items():
        x, y = middle[room], row[room] * ROW + 17
        parts.append(
            f'<rect x="{x - 125}" y="{y}" width="250" height="{HIGH}" rx="6" fill="#eaf2f8"'
            f' stroke="#0072b2"/><text x="{x}" y="{y + 21}" font-weight="bold">{room}</text>'
            f'<text x="{x}" y="{y + 39}" font-size="13">{text}</text>'
        )
        for other in sorted(below[room] - {far for near in below[room] for far in below[near]}):
            parts.append(
                f'<path d="M{x} {y + HIGH}L{middle[other]} {row[other] * ROW + 17}" stroke="#555"'
                ' marker-end="url(#tip)"/>'
            )
    return '\n'.join([*parts, '</svg>\n'])

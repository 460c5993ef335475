# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Work done once when the package is set up: ``python -m tdm_planner.set_up``.

Compiles the kernels of every registered problem, so that the first request to a planner is
answered at once.
"""

from __future__ import annotations

from importlib.metadata import entry_points
import time

from tdm_planner.problems import Problem

GROUP = 'tdm_planner.problems'


def prepare_problems() -> None:
    """Let every registered problem compile and tabulate what does not depend on a request."""
    for entry_point in sorted(entry_points(group=GROUP), key=lambda found: found.name):
        started = time.monotonic()
        problem_class: type[Problem] = entry_point.load()
        problem_class.from_parameters({}).prepare()
        print(f'      {entry_point.name}: {time.monotonic() - started:.1f} s')


if __name__ == '__main__':
    prepare_problems()

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Work done once when the package is set up: ``python -m tdm_planner.set_up``.

Compiles the kernels of every problem, so that the first request to a planner is answered at once.
"""

from __future__ import annotations

import sys

from tdm_planner.exceptions import TdmError
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_sim.progress import Progress


def main() -> int:
    """Let every problem compile what does not depend on a request; returns the exit status."""
    failures: list[str] = []
    with Progress() as progress:
        for name in problem_names():
            progress.phase(f'compiling kernels of {name}')
            try:
                load_problem(name).from_parameters({}).prepare()
            except TdmError as error:
                failures.append(f'{name} cannot be prepared: {error}')
        progress.phase('kernels are compiled')
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())

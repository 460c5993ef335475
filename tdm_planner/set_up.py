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


def prepare_problems() -> dict[str, str]:
    """
    Let every problem compile and tabulate what does not depend on a request.

    Returns what was wrong, by problem; empty if all is well.
    """
    failures: dict[str, str] = {}
    with Progress() as progress:
        for name in problem_names():
            progress.phase(f'compiling kernels of {name}')
            try:
                load_problem(name).from_parameters({}).prepare()
            except TdmError as error:
                failures[name] = str(error)
        progress.phase('kernels are compiled')
    return failures


def main() -> int:
    """Prepare all problems; returns the exit status."""
    failures = prepare_problems()
    for name, reason in failures.items():
        print(f'{name} cannot be prepared: {reason}', file=sys.stderr)
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())

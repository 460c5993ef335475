# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Near-optimal trajectories in real time by Taranenko's direct method."""

from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    TdmError,
    VerificationFailed,
)
from tdm_planner.starting import begin


def _version() -> str:
    # Here, as it takes 30 ms, in which a signal would end in a traceback before `begin`.
    from importlib.metadata import version

    return version('tdm_planner')


begin()

__version__ = _version()

__all__ = [
    'DeadlineExceeded',
    'Infeasible',
    'InvalidProblem',
    'TdmError',
    'VerificationFailed',
    '__version__',
]

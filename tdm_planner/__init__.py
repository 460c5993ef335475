# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Near-optimal trajectories in real time by Taranenko's direct method."""

from importlib.metadata import version

from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    TdmError,
    VerificationFailed,
)
from tdm_planner.starting import begin

begin()

__version__ = version('tdm_planner')

__all__ = [
    'DeadlineExceeded',
    'Infeasible',
    'InvalidProblem',
    'TdmError',
    'VerificationFailed',
    '__version__',
]

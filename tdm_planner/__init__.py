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
from tdm_planner.starting import end_quietly_on_signals

end_quietly_on_signals()

__version__ = '0.1.0'

__all__ = [
    'DeadlineExceeded',
    'Infeasible',
    'InvalidProblem',
    'TdmError',
    'VerificationFailed',
    '__version__',
]

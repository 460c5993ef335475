# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of functions by central differences, to compare others with."""

from collections.abc import Callable
from typing import Any

import numpy as np


def central(function: Callable[[Any], Any], at: Any, step: float = 1e-6) -> Any:
    """Return the derivative (..., n) of a function (...) of n numbers."""
    changes = step * np.eye(len(at))
    slopes = [np.subtract(function(at + h), function(at - h)) / (2 * step) for h in changes]
    return np.stack(slopes, axis=-1)

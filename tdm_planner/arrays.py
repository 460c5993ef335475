# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Types of arrays, and what is computed of them in many places.

Their shapes stand in docstrings: the types do not tell them.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.intp]
Mask: TypeAlias = NDArray[np.bool_]


def wrapped(angle: Array) -> Array:
    """Angle(s) [rad] brought into [-pi, pi) by whole turns."""
    return np.asarray((angle + math.pi) % math.tau - math.pi)


def largest_of_unit(ranges: Array, units: Sequence[str]) -> Array:
    """Return for every state (nx,) the largest of the `ranges` (nx,) of its unit."""
    names = np.array(units)
    return np.array([ranges[names == unit].max() for unit in units])

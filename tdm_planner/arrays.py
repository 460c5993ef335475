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

_ORDER = 13  # of Taylor's series: of matrices of norm 1/2 all digits


def wrapped(angle: Array) -> Array:
    """Angle(s) [rad] brought into [-pi, pi) by whole turns."""
    return np.asarray((angle + math.pi) % math.tau - math.pi)


def largest_of_unit(ranges: Array, units: Sequence[str]) -> Array:
    """Return for every state (nx,) the largest of the `ranges` (nx,) of its unit."""
    names = np.array(units)
    return np.array([ranges[names == unit].max() for unit in units])


def exponentials(matrices: Array) -> Array:
    """
    Return the exponentials of matrices (..., m, m), by Taylor's series of matrices halved enough.

    `scipy.linalg.expm` takes one after the other, and up to a hundred times as long where the
    threads of its BLAS find the processor busy.
    """
    size = float(np.abs(matrices).sum(axis=-1).max(initial=0.0))
    halvings = max(0, math.ceil(math.log2(size)) + 1) if 0.0 < size < math.inf else 0
    scaled, identity = matrices / 2.0**halvings, np.eye(matrices.shape[-1])
    found = identity + scaled / _ORDER
    for order in range(_ORDER - 1, 0, -1):
        found = identity + scaled @ found / order
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found)

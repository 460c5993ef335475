# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What all reference functions have in common, and the bases they are made of."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@runtime_checkable
class ReferenceFunction(Protocol):
    """
    A function x(tau) on the virtual arc [tau_0, tau_f] that meets its boundary conditions.

    It is linear in its parameters (m of them), so that `jacobian` is exact and does not depend on
    their values. It goes on beyond the ends of the arc, and is evaluated there if asked.
    """

    tau_0: float
    tau_f: float

    def __call__(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the `order`-th derivative at tau (n...,): shape (n..., value shape)."""

    def jacobian(self, tau: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of `x(tau, order)` with respect to the parameters, (n..., m)."""


@runtime_checkable
class ReferenceBasis(Protocol):
    """
    A family of reference functions on the unit interval, split by what determines them.

    x(s) = given(s) @ b + varied(s) @ a, where b holds the derivatives of orders `start` at s = 0,
    then those of orders `end` at s = 1, and a is free: whatever a is, the conditions hold.
    """

    @property
    def start(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 0."""

    @property
    def end(self) -> tuple[int, ...]:
        """Orders of the derivatives given at s = 1."""

    def given(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative at s (...) of the part of every condition."""

    def varied(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative at s (...) of every free shape."""

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A plant whose physical constants differ from those of its controller's model."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.parameters import build, to_mapping

PlantType = TypeVar('PlantType')


def mismatched(plant: PlantType, mismatch: float, seed: int) -> PlantType:
    """
    Return a copy of a plant with every physical constant off by a random relative error.

    The errors are independent and uniform in +-`mismatch`; the same seed gives the same plant.
    Constants are the numbers declared as parameters of the plant's dataclass, groups included.

    Raises
    ------
    InvalidProblem
        If the disturbed constants do not make a plant (a mismatch of 1 or more may do that).

    """
    generator = np.random.default_rng(seed)
    constants = {
        name: value * (1.0 + mismatch * generator.uniform(-1.0, 1.0))
        if isinstance(value, float)
        else value
        for name, value in to_mapping(plant).items()
    }
    return build(type(plant), constants)


def mismatched_gains(count: int, mismatch: float, seed: int) -> NDArray[np.float64]:
    """
    Return the gain of each of `count` actuators, delivered per commanded, (count,).

    Uniform in 1 +- `mismatch`, independent of the errors that `mismatched` draws from the seed.
    """
    generator = np.random.default_rng([seed, 1])
    return 1.0 + mismatch * generator.uniform(-1.0, 1.0, count)

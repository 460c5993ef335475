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

"""Actuator commands in sensor_msgs/JointState messages."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, Literal

from tdm_planner.parameters import shown

_MOST_NAMES = 10  # that a sentence lists


class MalformedCommand(ValueError):
    """A command that cannot be followed; the message says why in one sentence."""


def read_joint(message: Any, joint: str, quantity: Literal['velocity', 'effort']) -> float:
    """
    Return one joint's commanded `quantity` from a JointState.

    Raises
    ------
    MalformedCommand
        If the joint is missing or there twice, the array's length does not match the names, or
        the value is not finite.

    """
    names: Sequence[str] = message.name
    values: Sequence[float] = getattr(message, quantity)
    if names.count(joint) != 1:
        found = ', '.join(shown(name) for name in names[:_MOST_NAMES]) or 'none'
        raise MalformedCommand(f"it must name joint '{joint}' once, but its names are: {found}")
    if len(values) != len(names):
        raise MalformedCommand(
            f"'{quantity}' has {len(values)} values for {len(names)} named joints"
        )
    value = float(values[list(names).index(joint)])
    if not math.isfinite(value):
        raise MalformedCommand(
            f"the {quantity} of joint '{joint}' is {value}, not a finite number"
        )
    return value

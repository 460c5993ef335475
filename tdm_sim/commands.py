# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Actuator commands in sensor_msgs/JointState messages."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, Literal


class MalformedCommand(ValueError):
    """A command that cannot be followed; the message says why in one sentence."""


def read_joint(message: Any, joint: str, quantity: Literal['velocity', 'effort']) -> float:
    """Return one joint's commanded `quantity` from a JointState.

    Raises
    ------
    MalformedCommand
        If the joint is missing or there twice, the array's length does not match the names, or
        the value is not finite.
    """
    names: Sequence[str] = message.name
    values: Sequence[float] = getattr(message, quantity)
    if names.count(joint) != 1:
        found = ', '.join(names) or 'none'
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

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Sliders made from parameter descriptors: range, unit, description.

If the declared range is very wide, the slider covers a few times the initial value instead.
"""

from __future__ import annotations

from collections.abc import Iterable
import math
import re
from typing import Any, NamedTuple

WIDEST = 50.0  # times the value that a range may be as wide, to be shown whole
GROUPS = ('limits', 'weights')  # of parameters that are shown first

_SPREAD = (
    4.0  # of a slider over a wide range: from 0 or a quarter of the value to so many times it
)
_STEPS = 200
_DOUBLE, _INTEGER = 3, 2  # of rcl_interfaces/msg/ParameterType
_NOT_SHOWN = re.compile(r'(start\.(max_age|delay)|replan\.|solver\.|markers\.|.*seed$|rate$)')


class Slider(NamedTuple):
    """A parameter to be moved: its whole name, its interval, its unit and what it is."""

    name: str
    low: float
    high: float
    step: float
    value: float
    unit: str
    hint: str

    @property
    def group(self) -> str:
        """Return what it is shown among; '' for parameters without a group."""
        return self.name.rpartition('.')[0]


def slider_of(descriptor: Any, value: Any) -> Slider | None:
    """Return the slider of a parameter's descriptor and value; None where it has none."""
    number = descriptor.type in (_DOUBLE, _INTEGER)
    if not number or descriptor.read_only or not isinstance(value, float | int):
        return None
    if _NOT_SHOWN.match(descriptor.name):
        return None
    whole = descriptor.type == _INTEGER
    declared = descriptor.integer_range if whole else descriptor.floating_point_range
    low, high = (
        (declared[0].from_value, declared[0].to_value) if declared else (-math.inf, math.inf)
    )
    low, high = shown_range(float(value), float(low), float(high))
    step = (high - low) / _STEPS
    if whole:
        low, high, step = math.floor(low), math.ceil(high), max(1, round(step))
    text, _, unit = descriptor.description.rpartition(' [')
    if not text:
        text, unit = descriptor.description, ''
    hint = f'{descriptor.name}: {text}. {descriptor.additional_constraints}'.strip()
    return Slider(descriptor.name, low, high, step, value, unit.rstrip(']'), hint)


def shown_range(value: float, low: float, high: float) -> tuple[float, float]:
    """Return the interval that a slider covers, for a value and what is declared as allowed."""
    size = abs(value) or 1.0
    if high - low <= WIDEST * size:
        return low, high
    if value < 0.0 or low < 0.0:
        below, above = value - _SPREAD * size, value + _SPREAD * size
    else:
        below, above = (value / _SPREAD if value else 0.0), _SPREAD * size
    return max(low, below), min(high, above)


def in_order(sliders: Iterable[Slider]) -> dict[str, list[Slider]]:
    """Return sliders by group: limits and weights first, what is about the plant last."""
    groups: dict[str, list[Slider]] = {}
    for slider in sliders:
        groups.setdefault(slider.group, []).append(slider)

    def rank(group: str) -> tuple[int, str]:
        first = group.partition('.')[0]
        if first in GROUPS:
            return GROUPS.index(first), group
        return (4 if first in ('plant', 'noise', 'estimator') else 3), group

    return {group: groups[group] for group in sorted(groups, key=rank)}

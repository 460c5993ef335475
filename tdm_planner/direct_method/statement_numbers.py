# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The numbers of a statement, which are arguments of its graphs, and what is left without them."""

from __future__ import annotations

from collections.abc import Mapping
import copy
import dataclasses
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def numbers(formulation: Any, prefix: str = '') -> dict[str, Array]:
    """Floats, and sequences of numbers, among a dataclass's fields by dotted name, (n,) each."""
    found: dict[str, Array] = {}
    for name, value in _fields(formulation).items():
        if isinstance(value, float):
            found[prefix + name] = np.array([value])
        elif isinstance(value, list | tuple) and value and all(map(_is_number, value)):
            found[prefix + name] = np.array(value, dtype=float)
        elif dataclasses.is_dataclass(value):
            found.update(numbers(value, f'{prefix}{name}.'))
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _fields(formulation: Any) -> dict[str, Any]:
    """Values of a dataclass's fields; how it is solved is no part of the statement."""
    if not dataclasses.is_dataclass(formulation):
        return {}
    names = [field.name for field in dataclasses.fields(formulation)]
    return {name: getattr(formulation, name) for name in names if name != 'solver'}


def twin_of(formulation: Any, symbols: Mapping[str, Any], prefix: str = '') -> Any:
    """Return a copy with symbols for some of its numbers, not validated."""
    twin, fields = copy.copy(formulation), _fields(formulation)
    if not dataclasses.is_dataclass(formulation):
        return twin
    for name in set(vars(twin)) - {*fields, 'solver'}:
        del twin.__dict__[name]  # what was computed from the numbers before
    for name, value in fields.items():
        found, path = value, prefix + name
        if path in symbols:
            parts = ca.vertsplit(symbols[path])
            found = parts[0] if isinstance(value, float) else type(value)(parts)
        elif dataclasses.is_dataclass(value):
            found = twin_of(value, symbols, f'{path}.')
        object.__setattr__(twin, name, found)
    return twin


def structure(formulation: Any, found: Mapping[str, Array], prefix: str = '') -> list[Any]:
    """Return the fields that are no numbers."""
    rest: list[Any] = []
    for name, value in _fields(formulation).items():
        if dataclasses.is_dataclass(value):
            rest.append((name, structure(value, found, f'{prefix}{name}.')))
        elif prefix + name not in found:
            rest.append((name, value))
    return rest

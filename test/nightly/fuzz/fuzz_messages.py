# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Generated mappings as messages: plain objects for the readers, ROS messages for the wire."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import SimpleNamespace
from typing import Any


def plain(value: Any) -> Any:
    """Return a mapping as an object with attributes, as the readers see a message."""
    if isinstance(value, Mapping):
        return SimpleNamespace(**{key: plain(item) for key, item in value.items()})
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def fill(message: Any, value: Mapping[str, Any]) -> Any:
    """Set the fields of a ROS message from a mapping, and return it."""
    kinds = message.get_fields_and_field_types()
    for name, item in value.items():
        kind = kinds[name].removeprefix('sequence<').removesuffix('>')
        if '/' not in kind:
            setattr(message, name, item)
        elif isinstance(item, list):
            setattr(message, name, [fill(_made(kind), part) for part in item])
        else:
            fill(getattr(message, name), item)
    return message


def _made(kind: str) -> Any:
    package, name = kind.split('/')
    return getattr(import_module(f'{package}.msg'), name)()

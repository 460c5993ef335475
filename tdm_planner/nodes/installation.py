# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""ROS 2 comes natively (apt) or as Python wheels; the two must not meet in one process."""

from __future__ import annotations

from collections.abc import Mapping
import importlib.util
import os
from pathlib import Path
import sys


class MixedInstallations(ImportError):
    """A sourced ROS 2 and the wheels would be loaded together, a library of each at random."""


def native_prefixes(environment: Mapping[str, str]) -> list[str]:
    """Return the sourced installations that bring their own rclpy, from AMENT_PREFIX_PATH."""
    prefixes = environment.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [p for p in prefixes if p and any(Path(p).glob('lib/python*/*-packages/rclpy'))]


def require_one_ros(environment: Mapping[str, str] = os.environ) -> None:
    """
    Refuse to go on where both kinds of installation are visible.

    Raises
    ------
    MixedInstallations
        Naming both, and the ways out.

    """
    if importlib.util.find_spec('ros_wheels_bootstrapper') is None:
        return
    native = native_prefixes(environment)
    if native:
        raise MixedInstallations(
            f'ROS 2 is sourced from {native[0]} and also installed as wheels in {sys.prefix}: '
            'use a shell in which ROS 2 is not sourced, or a Python environment without the wheels'
        )

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

"""Where the package's files (parameter files, launch files) are, however it was installed."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import sys

PACKAGE = 'tdm_planner'


def share_directory() -> Path:
    """
    Folder that holds `config` and `launch`.

    The first of: the prefixes of a sourced ROS 2 workspace (colcon), the Python environment (pip),
    the source tree (an editable installation, or none).

    Raises
    ------
    FileNotFoundError
        Naming the folders that were tried.

    """
    tried = list(_candidates())
    for folder in tried:
        if (folder / 'config').is_dir():
            return folder
    raise FileNotFoundError(
        f"the files of '{PACKAGE}' are not installed; looked in " + ', '.join(map(str, tried))
    )


def _candidates() -> Iterator[Path]:
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        marker = Path(prefix) / 'share/ament_index/resource_index/packages' / PACKAGE
        if prefix and marker.is_file():
            yield Path(prefix) / 'share' / PACKAGE
    yield Path(sys.prefix) / 'share' / PACKAGE
    yield Path(__file__).resolve().parents[1]


def config_file(name: str) -> Path:
    """
    Path of the parameter file `name`, e.g. ``pendulum.yaml``.

    Raises
    ------
    FileNotFoundError
        Listing the parameter files there are.

    """
    folder = share_directory() / 'config'
    path = folder / name
    if not path.is_file():
        names = ', '.join(sorted(p.name for p in folder.glob('*.yaml'))) or 'none'
        raise FileNotFoundError(f"no parameter file '{name}' in {folder}; there is: {names}")
    return path

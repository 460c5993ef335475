# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Where the package's files (parameter files, launch files) are, however it was installed."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import shutil
import sys

from tdm_planner.exceptions import InvalidProblem

PACKAGE = 'tdm_planner'


def share_directory() -> Path:
    """
    Folder that holds `config` and `launch`.

    The first of: the prefixes of a sourced ROS 2 workspace (colcon), the Python environment (pip),
    the source tree (an editable installation, or none).

    Raise FileNotFoundError, naming the folders that were tried, if it is in none.
    """
    tried = [prefix / 'share' / PACKAGE for prefix in (*ament_prefixes(PACKAGE), Path(sys.prefix))]
    tried.append(Path(__file__).resolve().parents[1])
    for folder in tried:
        if (folder / 'config').is_dir():
            return folder
    raise FileNotFoundError(
        f"the files of '{PACKAGE}' are not installed; looked in " + ', '.join(map(str, tried))
    )


def ament_prefixes(package: str) -> Iterator[Path]:
    """Where a package of ROS 2 is installed, of what is sourced, the overlay first."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        marker = Path(prefix) / 'share/ament_index/resource_index/packages' / package
        if prefix and marker.is_file():
            yield Path(prefix)


def executable_of(package: str, name: str) -> str:
    """
    Path of the program that ``ros2 run PACKAGE NAME`` runs.

    Raise InvalidProblem, saying what to install, if it is not installed.
    """
    for prefix in ament_prefixes(package):
        found = shutil.which(name, path=prefix / 'lib' / package)
        if found is not None:
            return found
    distribution = os.environ.get('ROS_DISTRO', 'jazzy')
    way = f'sudo apt install ros-{distribution}-{package.replace("_", "-")}'
    if package == PACKAGE:
        way = 'source the workspace in which colcon has built it'
    raise InvalidProblem(f"'{name}' of package '{package}' is not installed: {way}")


def config_file(name: str) -> Path:
    """
    Path of the parameter file `name`, e.g. ``pendulum.yaml``.

    Raise FileNotFoundError, listing the parameter files there are, if there is no such file.
    """
    folder = share_directory() / 'config'
    path = folder / name
    if not path.is_file():
        names = ', '.join(sorted(p.name for p in folder.glob('*.yaml'))) or 'none'
        raise FileNotFoundError(f"no parameter file '{name}' in {folder}; there is: {names}")
    return path

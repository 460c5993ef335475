# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What a process does before it imports anything that takes long.

It looks for the packages and programs that must be installed. Processes of our own limit the
threads of BLAS and end quietly on a signal: the imports take about a second, in which Ctrl-C would
end in a traceback. From when a node runs, `tdm_planner.nodes.runtime` handles signals; from when a
command runs, `interruptible`: one signal interrupts it, others do not disturb the clean-up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import ctypes
from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

from tdm_planner.exceptions import InvalidProblem

PACKAGE = 'tdm_planner'
PARENT = 'TDM_PARENT'  # environment variable: process whose end, if killed, ends this one
# A hang-up is let pass where it is ignored from the start, as under nohup.
_HANG_UP = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
SIGNALS = (signal.SIGINT, signal.SIGTERM, *_HANG_UP)

NODES = {  # modules, by executable
    'planner': 'tdm_planner.nodes.planner',
    'tracker': 'tdm_planner.nodes.tracker',
    'plant': 'tdm_sim.stated_plant',
    'pendulum_plant': 'tdm_sim.pendulum_plant',
    'robot_plant': 'tdm_sim.robot_plant',
}
_COMMAND = 'tdm_planner.cli'
NO_ROS = (
    "this needs 'rclpy', which is not installed: source a ROS 2 installation, or run 'make setup' "
    'in the source tree'
)
# Packages that must be there, and what pip calls them.
REQUIRED = {name: name for name in (
    'casadi', 'daqp', 'matplotlib', 'mcap', 'numba', 'numpy', 'plotly', 'rich', 'rosbags', 'scipy',
    'zstandard',
)} | {'yaml': 'PyYAML'}  # fmt: skip


def begin() -> None:
    """
    Prepare the process of a node, of `tdm`, or of another module of the package.

    Called when the package is imported.
    """
    if started_as():
        if fault := _missing():
            sys.exit(fault)  # as a sentence, with code 1
        limit_threads()
        end_quietly_on_signals()
        _end_with_parent()


def require_packages() -> None:
    """
    Have all required packages, in a process of the user's own.

    Raise ImportError if one is missing, with a sentence that says how to install it.
    """
    if fault := _missing():
        raise ImportError(fault)


def _missing() -> str:
    """Say which packages are missing and how to get them; '' if all are there."""
    names = ' '.join(pip for name, pip in REQUIRED.items() if find_spec(name) is None)
    if names:
        return (
            f'tdm_planner needs Python packages that are not installed: {names}; run '
            f"'make setup' in the source tree and then 'colcon build' if that installed this, or "
            f"'pip install {names}' into the environment"
        )
    return NO_ROS if started_as() == 'node' and find_spec('rclpy') is None else ''


def ament_prefixes(package: str) -> Iterator[Path]:
    """Where a package of ROS 2 is installed, of what is sourced, the overlay first."""
    for prefix in _sourced():
        if (prefix / 'share/ament_index/resource_index/packages' / package).is_file():
            yield prefix


def _sourced() -> list[Path]:
    return [Path(p) for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]


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


def require_one_ros() -> None:
    """
    Go on only where ROS 2 is there once, natively or as wheels: both would be loaded at random.

    Raise ImportError if there are two, naming both, and the ways out.
    """
    native = [p for p in _sourced() if any(p.glob('lib/python*/*-packages/rclpy'))]
    if native and find_spec('ros_wheels_bootstrapper') is not None:
        raise ImportError(
            f'ROS 2 is sourced from {native[0]} and also installed as wheels in {sys.prefix}: '
            'use a shell in which ROS 2 is not sourced, or a Python environment without the wheels'
        )


def limit_threads() -> None:
    """
    Let BLAS use one thread, unless the environment says otherwise; before numpy is imported.

    The matrices are small. The threads of OpenBLAS up to 0.3.24 (numpy 1.26) keep whole cores busy
    while they wait for work.
    """
    for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
        os.environ.setdefault(name, '1')


def end_quietly_on_signals() -> None:
    """
    End the process on one of `SIGNALS`, if it is that of a node or of `tdm`.

    The code is 0 for nodes, which have done what they were asked to.
    """
    kind = started_as()
    if kind not in ('node', 'tdm') or threading.current_thread() is not threading.main_thread():
        return

    def end(number: int, frame: object) -> None:
        # Nothing is open yet; an exception would be swallowed, or told, by the import under way.
        os._exit(0 if kind == 'node' else 128 + number)

    for number in SIGNALS:
        signal.signal(number, end)


def _end_with_parent() -> None:
    """On Linux, be interrupted when the thread of the process `PARENT` that started this ends."""
    parent = os.environ.pop(PARENT, '')
    if parent and sys.platform == 'linux':
        set_parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGINT)
        if os.getppid() != int(parent):  # it ended before
            os._exit(0)


def started_as() -> str:
    """Return what the process was started as: node, tdm, another module of ours, or none: ''."""
    words = iter(sys.orig_argv[1:])
    for word in words:
        if word == '-m':
            module = next(words, '')
            ours = 'module' if module.partition('.')[0] in (PACKAGE, 'tdm_sim') else ''
            return 'node' if module in NODES.values() else 'tdm' if module == _COMMAND else ours
        if word in ('-W', '-X'):  # options whose value is a word of its own
            next(words, '')
        elif word == '-c' or not word.startswith('-'):
            break  # what follows are the arguments of a script
    executable = Path((getattr(sys, 'argv', None) or [''])[0]).name
    return 'node' if executable in NODES else 'tdm' if executable == 'tdm' else ''


class Interrupted(KeyboardInterrupt):
    """A signal asked the command to end; `code` is the exit status that shells give it."""

    def __init__(self, number: int) -> None:
        super().__init__(f'signal {number}')
        self.code = 128 + number


def ignore_signals() -> None:
    """Let signals pass from now on (main thread only)."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Let a handler have the signals meanwhile; in another thread than the main one, nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = [signal.signal(number, handler) for number in SIGNALS]
    try:
        yield
    finally:
        for number, before in zip(SIGNALS, previous, strict=True):
            signal.signal(number, before)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the first of `SIGNALS` raise `Interrupted`, and further ones pass."""
    interrupted: list[Interrupted] = []

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        ignore_signals()
        interrupted.append(Interrupted(number))
        raise interrupted[0]

    with handled_by(interrupt):
        try:
            yield
        except Exception as error:  # noqa: B902
            # An extension that is being imported makes an ImportError of it.
            if interrupted:
                raise interrupted[0] from error
            raise


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let signals wait until the block has ended, so that it is done whole or not at all."""
    waiting: list[int] = []
    try:
        with handled_by(lambda number, frame: waiting.append(number)):
            yield
    finally:
        if waiting:
            signal.raise_signal(waiting[0])

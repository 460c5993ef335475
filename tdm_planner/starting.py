# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A node's process ends quietly on a signal from its first moment on, while it is importing.

The imports of a node take about a second, in which Ctrl-C would end in a traceback. From when a
node runs, `tdm_planner.nodes.runtime` handles signals.
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys
import threading

EXECUTABLES = ('planner', 'tracker', 'pendulum_plant', 'robot_plant')


def end_quietly_on_signals() -> None:
    """End the process with code 0 on SIGINT and SIGTERM, if it is that of a node."""
    if is_node() and threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _end)


def is_node() -> bool:
    """Whether the process was started as a node: as a module, or as one of the executables."""
    words = sys.orig_argv
    if '-m' in words[:-1]:
        package, _, name = words[words.index('-m') + 1].rpartition('.')
        return name in EXECUTABLES and package in ('tdm_planner.nodes', 'tdm_sim')
    script = Path(sys.argv[0]) if getattr(sys, 'argv', None) else Path()
    return script.name in EXECUTABLES


def _end(number: int, frame: object) -> None:
    # Nothing is open yet; an exception would be swallowed, or told, by the import under way.
    os._exit(0)

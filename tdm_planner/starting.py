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

"""
Nodes and `tdm` end quietly on a signal from their first moment on, while they are importing.

The imports take about a second, in which Ctrl-C would end in a traceback. From when a node runs,
`tdm_planner.nodes.runtime` handles signals; from when a command runs, `interruption`.
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys
import threading

EXECUTABLES = ('planner', 'tracker', 'pendulum_plant', 'robot_plant')


def end_quietly_on_signals() -> None:
    """
    End the process on SIGINT and SIGTERM, if it is that of a node or of `tdm`.

    The code is 0 for nodes and recordings, which have done what they were asked to.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    if is_node() or command()[1:2] == ['record']:
        handler = _end
    elif command():
        handler = _give_up
    else:
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def is_node() -> bool:
    """Whether the process was started as a node: as a module, or as one of the executables."""
    words = sys.orig_argv
    if '-m' in words[:-1]:
        package, _, name = words[words.index('-m') + 1].rpartition('.')
        return name in EXECUTABLES and package in ('tdm_planner.nodes', 'tdm_sim')
    script = Path(sys.argv[0]) if getattr(sys, 'argv', None) else Path()
    return script.name in EXECUTABLES


def command() -> list[str]:
    """Return the words of the `tdm` command that the process was started as, else none."""
    words = sys.orig_argv
    if '-m' in words[:-1]:
        after = words.index('-m') + 2
        return ['tdm', *words[after:]] if words[after - 1] == 'tdm_planner.cli' else []
    arguments = getattr(sys, 'argv', None) or ['']
    return ['tdm', *arguments[1:]] if Path(arguments[0]).name == 'tdm' else []


def _end(number: int, frame: object) -> None:
    # Nothing is open yet; an exception would be swallowed, or told, by the import under way.
    os._exit(0)


def _give_up(number: int, frame: object) -> None:
    os._exit(128 + number)

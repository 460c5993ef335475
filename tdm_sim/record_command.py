# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Which topics are recorded, and the command for launch files.

That is `ros2 bag record` where it is installed, else `tdm record`.
"""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime
import re

from tdm_planner.starting import ament_prefixes, executable_of

RECORDING = 'recording to'  # how the line begins that `tdm record` prints with the first message
# Topics that belong to no namespace, and are recorded with any.
SHARED_TOPICS = frozenset({'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'})


def is_wanted(topic: str, names: Collection[str] = (), namespace: str | None = None) -> bool:
    """
    Whether a topic, by its full name, is to be recorded: those named, and all in a namespace.

    With a namespace come `SHARED_TOPICS`; with neither, all topics. Hidden ones must be named.
    """
    if topic in names or any(part.startswith('_') for part in topic.split('/')):
        return topic in names
    return not names if namespace is None else bool(re.match(topics_pattern(namespace), topic))


def record_command(namespace: str, bag: str = '', use_sim_time: bool = False) -> list[str]:
    """
    Return the words of a command that records all topics in a namespace, and shared ones.

    It records until it is interrupted, to `bag` or a folder named after namespace and time. With
    `use_sim_time` that of ROS 2 notes when messages came by /clock; ours has the computer's time.
    """
    space = namespace.strip('/')
    folder = bag or f'{space.replace("/", "_") or "tdm"}_{datetime.now():%Y_%m_%d-%H_%M_%S}'
    if any(ament_prefixes('ros2bag')):
        command = ['ros2', 'bag', 'record', '--output', folder, '--regex', topics_pattern(space)]
        return [*command, '--use-sim-time'] if use_sim_time else command
    return [
        *(executable_of('tdm_planner', 'tdm'), 'record', '--quiet'),
        *('--output', folder, '--namespace', f'/{space}'),
    ]


def topics_pattern(namespace: str) -> str:
    """Return the regular expression of the topics that `is_wanted` with a namespace wants."""
    below = f'/{namespace.strip("/")}/'.replace('//', '/')
    shared = '|'.join(re.escape(topic) for topic in sorted(SHARED_TOPICS))
    return f'^({re.escape(below)}.*|{shared})$'

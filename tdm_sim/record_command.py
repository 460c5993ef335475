# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Which topics are recorded, and the command for launch files.

That is `ros2 bag record` where it is installed, else `tdm record`.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
import re

from tdm_planner.resources import ament_prefixes, executable_of

RECORDING = 'recording to'  # how the line begins that `tdm record` prints with the first message
# Topics that belong to no namespace, and are recorded with any.
SHARED_TOPICS = frozenset({'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'})


@dataclass(frozen=True)
class TopicChoice:
    """
    Topics by their full names, and all in a namespace; with neither, all there are.

    With a namespace come `SHARED_TOPICS`. Hidden topics are recorded only if they are named.
    """

    names: frozenset[str] = frozenset()
    namespace: str | None = None

    def wants(self, topic: str) -> bool:
        """Whether a topic, by its full name, is to be recorded."""
        if topic in self.names:
            return True
        if any(part.startswith('_') for part in topic.split('/')):
            return False
        if self.namespace is None:
            return not self.names
        return re.match(topics_pattern(self.namespace), topic) is not None


def record_command(namespace: str, bag: str = '', use_sim_time: bool = False) -> list[str]:
    """
    Return the words of a command that records all topics in a namespace, and shared ones.

    It records to the folder `bag`, by default one named after namespace and time, until it is
    interrupted. With `use_sim_time` the recorder of ROS 2 notes when messages came by /clock; ours
    always does by the computer's time.
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
    """Return the regular expression of the topics that `TopicChoice(namespace=...)` wants."""
    below = f'/{namespace.strip("/")}/'.replace('//', '/')
    shared = '|'.join(re.escape(topic) for topic in sorted(SHARED_TOPICS))
    return f'^({re.escape(below)}.*|{shared})$'

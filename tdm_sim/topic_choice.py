# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which topics are recorded."""

from __future__ import annotations

from dataclasses import dataclass

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
        below = f'/{self.namespace.strip("/")}/'.replace('//', '/')
        return topic.startswith(below) or topic in SHARED_TOPICS

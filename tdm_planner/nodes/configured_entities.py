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

"""What a managed node has while it is configured: topics, services, timers that end together."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from rclpy.lifecycle.node import LifecycleNodeMixin
from rosgraph_msgs.msg import Clock
from tdm_planner.nodes.ros_parameters import ParameterNode


class ConfiguredEntities(LifecycleNodeMixin, ParameterNode):
    """
    A lifecycle node in which what is created after `keep_entities` goes with the configuration.

    Publishers made then are silent unless the node is active.
    """

    _kept: frozenset[int] | None = None
    _configuration = 0

    @property
    @abstractmethod
    def active(self) -> bool:
        """Whether the node is at work."""

    def keep_entities(self) -> None:
        """Let what there is stay for as long as the node; to be called before configuring."""
        if self._kept is None:
            self._kept = frozenset(id(item) for item, _ in self._entities())

    def destroy_entities(self) -> None:
        """
        Destroy what was created since.

        EventsExecutor may still call what was about to be called: this comes to nothing.
        """
        self._configuration += 1
        kept = self._kept or frozenset()
        for item, destroy in list(self._entities()):
            of_rclpy = getattr(item, 'msg_type', None) is Clock  # made with use_sim_time
            if id(item) not in kept and not of_rclpy:
                destroy(item)

    def create_publisher(self, *args: Any, **kwargs: Any) -> Any:
        """Create a publisher that speaks while the node is active only."""
        if self._kept is None:
            return super().create_publisher(*args, **kwargs)
        publisher = self.create_lifecycle_publisher(*args, **kwargs)
        if self.active:
            publisher.on_activate(None)
        return publisher

    def create_timer(
        self, timer_period_sec: float, callback: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """Create a timer that ends with the configuration."""

        def guarded() -> None:
            if configuration == self._configuration:
                callback()

        configuration = self._configuration
        return super().create_timer(
            timer_period_sec, callback if self._kept is None else guarded, *args, **kwargs
        )

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """Create a subscription that ends with the configuration."""

        def guarded(message: Any) -> None:
            if configuration == self._configuration:
                callback(message)

        configuration = self._configuration
        scoped = self._kept is not None and msg_type is not Clock
        return super().create_subscription(
            msg_type, topic, guarded if scoped else callback, *args, **kwargs
        )

    def _entities(self) -> Iterator[tuple[Any, Callable[[Any], Any]]]:
        kinds: tuple[tuple[Iterable[Any], Callable[[Any], Any]], ...] = (
            (self.timers, self.destroy_timer),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.publishers, self.destroy_lifecycle_publisher),
        )
        for items, destroy in kinds:
            for item in items:
                yield item, destroy

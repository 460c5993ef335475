# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A node's state on `/diagnostics`, and a warning where a topic has several publishers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from tdm_planner.nodes.clocks import steady_timer
from tdm_planner.nodes.reading import Level

TOPIC = '/diagnostics'
PERIOD = 1.0  # s


@dataclass(frozen=True)
class Report:
    """A node's report: a level, one sentence, and figures by name."""

    level: Level
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)


class Diagnostics:
    """
    Publishes what `report` returns, every second and whenever level or message change.

    `name` is the status's, after the node's own. Call `update` after anything that may change it.
    """

    def __init__(self, node: Node, name: str, report: Callable[[], Report]) -> None:
        self._node = node
        self._name = name
        self._report = report
        self._last: tuple[Level, str] | None = None
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, 10)
        steady_timer(node, PERIOD, self._publish)

    def update(self) -> None:
        """Publish if level or message have changed."""
        report = self._report()
        if (report.level, report.message) != self._last:
            self._publish(report)

    def _publish(self, report: Report | None = None) -> None:
        report = report or self._report()
        self._last = (report.level, report.message)
        full_name = self._node.get_fully_qualified_name()
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=bytes([report.level]),
                name=f'{full_name}: {self._name}',
                message=report.message,
                hardware_id=full_name,
                values=[
                    KeyValue(key=key, value=f'{v:.6g}' if isinstance(v, float) else str(v))
                    for key, v in report.values.items()
                ],
            )
        ]
        self._publisher.publish(message)


class PublisherCount:
    """
    Counts the publishers of `topic`; if there are several, `warning` says so.

    `publishers` begins the sentence, `consequence` ends it. `changed` is called when the warning
    appears or disappears. A process that was killed counts until the middleware drops it, with
    Fast DDS some 20 s later.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        consequence: str,
        changed: Callable[[], None],
        publishers: str = 'planners',
    ) -> None:
        self._node, self._publishers = node, publishers
        self._topic = node.resolve_topic_name(topic)
        self._consequence, self._changed = consequence, changed
        self.count = 0
        steady_timer(node, PERIOD, self.look)

    @property
    def warning(self) -> str:
        """One sentence, '' where there is at most one publisher."""
        if self.count < 2:
            return ''
        return f'{self.count} {self._publishers} publish {self._topic}: {self._consequence}'

    def look(self) -> int:
        """Count now, and return the count."""
        before = self.warning
        self.count = self._node.count_publishers(self._topic)
        if self.warning != before:
            if self.warning:
                self._node.get_logger().warning(self.warning)
            self._changed()
        return self.count

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Recorder of topics to a rosbag2, for machines without `ros2 bag`.

Messages are written as they came over the wire, with the quality of service their publishers
offer and the wire's type hashes. One thread subscribes, opens, writes and closes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import importlib
from pathlib import Path
import threading
import time
from typing import Any

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tdm_planner.exceptions import InvalidProblem, TdmError
from tdm_planner.nodes.runtime import check_namespace, check_topic, LONGEST_WAIT, make_executor
from tdm_planner.starting import handled_by
from tdm_sim.bag_writer import BagWriter, RecordingError
from tdm_sim.progress import Progress

RECORDING = 'recording to'  # how the line begins that is printed with the first message
# Topics that belong to no namespace, and are recorded with any.
SHARED_TOPICS = frozenset({'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'})
DISCOVERY_PERIOD = 0.05  # s between looks for topics that have appeared
LIVE_PERIOD, PLAIN_PERIOD = 0.5, 10.0  # s between updates of the live line, and plain lines
# Quality of service that every publisher's offer matches, as strong as all of them allow; deep
# enough for a burst that arrives while a chunk is written to disk.
AS_OFFERED = QoSProfile(
    depth=1000,
    reliability=ReliabilityPolicy.BEST_AVAILABLE,
    durability=DurabilityPolicy.BEST_AVAILABLE,
)


class IncompleteRecording(RecordingError):
    """A recording ended before it was asked to."""


@dataclass(frozen=True)
class Figures:
    """Seconds since the start, messages by topic, those lost on the way, bytes, messages/s."""

    elapsed: float
    counts: Mapping[str, int]
    dropped: int = 0
    size: int = 0
    rate: float = 0.0

    @property
    def messages(self) -> int:
        """Messages written, all topics together."""
        return sum(self.counts.values())

    def __str__(self) -> str:
        return (
            f'{self.elapsed:.0f} s, {self.messages} messages on {len(self.counts)} topics, '
            f'{self.rate:.0f}/s, {self.size / 1e6:.1f} MB, {self.dropped} dropped'
        )


class Recorder(Node):
    """
    A node that subscribes topics as they appear and hands their messages to a writer.

    `topics` are names as users give them; `is_wanted` says which are recorded.
    """

    def __init__(
        self, writer: BagWriter, topics: Sequence[str], namespace: str | None, **options: Any
    ) -> None:
        super().__init__(
            'recorder', start_parameter_services=False, enable_rosout=False, **options
        )
        self._writer, self._namespace = writer, namespace
        self._names = {self.resolve_topic_name(topic) for topic in topics}
        self._known: set[str] = set()  # topics, recorded or skipped
        self._lost: dict[str, int] = {}
        self._start = self._read_at = time.monotonic()
        self._messages = 0
        self.create_timer(DISCOVERY_PERIOD, self.subscribe_new_topics)
        self.subscribe_new_topics()

    def figures(self) -> Figures:
        """Return the figures as they are, the rate since they were read last."""
        now, counts = time.monotonic(), self._writer.messages
        messages, dropped = sum(counts.values()), sum(self._lost.values())
        rate = (messages - self._messages) / (now - self._read_at)
        self._read_at, self._messages = now, messages
        return Figures(now - self._start, counts, dropped, self._writer.size, rate)

    def tell(self, shown: Progress) -> None:
        """Show the figures twice a second, or now and then where lines stay."""
        if time.monotonic() - self._read_at >= (LIVE_PERIOD if shown.live else PLAIN_PERIOD):
            (shown.update if shown.live else shown.phase)(str(self.figures()))

    def subscribe_new_topics(self) -> None:
        """Subscribe every wanted topic that has a publisher and is not recorded yet."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self._known or not is_wanted(topic, self._names, self._namespace):
                continue
            if publishers := self.get_publishers_info_by_topic(topic):
                self._known.add(topic)
                self._subscribe(topic, types, publishers)

    def _subscribe(self, topic: str, types: Sequence[str], publishers: Sequence[Any]) -> None:
        try:
            if len(types) != 1:
                raise InvalidProblem(f'it has several types: {", ".join(types)}')
            kind = message_class(types[0])
            connection = self._writer.add_topic(topic, types[0], publishers)
        except TdmError as error:
            self.get_logger().warning(f'{topic} is not recorded: {error}')
            return

        def write(data: bytes) -> None:
            # EventsExecutor cannot pass the message's info: the instant is taken here.
            self._writer.write(connection, time.time_ns(), data)

        def count_lost(event: Any) -> None:
            self._lost[topic] = event.total_count

        lost = SubscriptionEventCallbacks(message_lost=count_lost)
        self.create_subscription(kind, topic, write, AS_OFFERED, raw=True, event_callbacks=lost)


def is_wanted(topic: str, names: Collection[str] = (), namespace: str | None = None) -> bool:
    """
    Whether a topic, by its full name, is to be recorded: those named, and all in a namespace.

    With a namespace come `SHARED_TOPICS`; with neither, all topics. Hidden ones must be named.
    """
    if topic in names or any(part.startswith('_') for part in topic.split('/')):
        return topic in names
    if namespace is None:
        return not names
    below = f'/{namespace.strip("/")}/'.replace('//', '/')
    return topic in SHARED_TOPICS or topic.startswith(below)


def message_class(type_name: str) -> Any:
    """Return the class of a message type, `PACKAGE/msg/NAME`; InvalidProblem if not installed."""
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise InvalidProblem(f"its message type '{type_name}' is not installed here") from None


def record(
    output: Path | str,
    topics: Sequence[str] = (),
    storage: str = 'mcap',
    namespace: str | None = None,
    shown: Progress | None = None,
) -> Figures:
    """
    Record topics to the new folder `output` until one of `SIGNALS`; return the final figures.

    `is_wanted` says what is recorded, also of topics that appear later. Raise RecordingError if
    the folder exists or cannot be made, or the storage is unknown; IncompleteRecording if the disk
    gets full: the bag holds, and is closed with, what was recorded until then.
    """
    for topic in topics:
        check_topic(topic, 'TOPIC')
    check_namespace(namespace or '', "'--namespace'")
    ended, begun, shown = threading.Event(), False, shown or Progress(quiet=True)
    with (
        handled_by(lambda *_: ended.set()),  # instead of interrupting a write
        rclpy.Context() as context,
        BagWriter(Path(output), storage) as writer,
    ):
        node = Recorder(writer, topics, namespace, context=context)
        executor = make_executor(context)
        executor.add_node(node)
        try:
            while not ended.is_set() and not writer.failure:
                executor.spin_once(timeout_sec=LONGEST_WAIT)
                if not begun and any(writer.messages.values()):
                    begun = True
                    shown.phase(f'{RECORDING} {output}: Ctrl-C ends')
                writer.keep()
                node.tell(shown)
        finally:
            executor.shutdown()
            node.destroy_node()
    done = node.figures()
    if writer.failure:
        raise IncompleteRecording(
            f'{writer.failure}; the recording ends there, with {done.messages} messages'
        )
    return done

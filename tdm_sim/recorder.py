# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder of topics to a rosbag2, for machines without `ros2 bag`.

Messages are written as they came over the wire, with the quality of service their publishers
offer and the wire's type hashes. One thread subscribes, opens, writes and closes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
import signal
import sys
import threading
import time
from typing import Any, ClassVar

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from tdm_planner.exceptions import TdmError
from tdm_planner.nodes.runtime import LONGEST_WAIT, make_executor
from tdm_sim.bag_writer import BagWriter, RecordingError
from tdm_sim.wire_types import message_class, subscription_profile

DISCOVERY_PERIOD = 0.05  # s between looks for topics that have appeared
PROGRESS_PERIOD = 0.5  # s


@dataclass(frozen=True)
class Progress:
    """How far a recording is: seconds since its start, and messages written by topic."""

    elapsed: float
    counts: Mapping[str, int]

    @property
    def messages(self) -> int:
        """Messages written, all topics together."""
        return sum(self.counts.values())


class Recorder(Node):
    """A node that subscribes topics as they appear and hands their messages to a writer.

    `topics` are names as users give them; none means all but hidden ones.
    """

    def __init__(self, writer: BagWriter, topics: Sequence[str] = (), **options: Any) -> None:
        super().__init__(
            'recorder', start_parameter_services=False, enable_rosout=False, **options
        )
        self._writer = writer
        self._wanted = frozenset(self.resolve_topic_name(topic) for topic in topics)
        self._recorded: set[str] = set()
        self._skipped: set[str] = set()
        self.create_timer(DISCOVERY_PERIOD, self.subscribe_new_topics)
        self.subscribe_new_topics()

    def subscribe_new_topics(self) -> None:
        """Subscribe every wanted topic that has a publisher and is not recorded yet."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self._recorded or topic in self._skipped or not self._wants(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types, publishers)

    def _wants(self, topic: str) -> bool:
        if self._wanted:
            return topic in self._wanted
        return not any(part.startswith('_') for part in topic.split('/'))

    def _subscribe(self, topic: str, types: Sequence[str], publishers: Sequence[Any]) -> None:
        if len(types) != 1:
            self._skip(topic, f'it has several types: {", ".join(types)}')
            return
        try:
            kind = message_class(types[0])
            connection = self._writer.add_topic(topic, types[0], publishers)
        except TdmError as error:
            self._skip(topic, str(error))
            return
        self._recorded.add(topic)
        self.create_subscription(
            kind,
            topic,
            # EventsExecutor cannot pass the message's info: the instant is taken here.
            lambda data: self._writer.write(connection, time.time_ns(), data),
            subscription_profile([item.qos_profile for item in publishers]),
            raw=True,
        )

    def _skip(self, topic: str, reason: str) -> None:
        self._skipped.add(topic)
        self.get_logger().warning(f'{topic} is not recorded: {reason}')


def record(
    output: Path | str,
    topics: Sequence[str] = (),
    storage: str = 'mcap',
    *,
    duration: float | None = None,
    stop: threading.Event | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Record topics to the new folder `output` until SIGINT or SIGTERM.

    Without `topics` everything is recorded but hidden topics; topics that appear later are taken
    up. Ends earlier after `duration` s or when `stop` is set. `on_progress` is called about twice
    a second. Returns the final figures. A recording that fails leaves what it has.

    Raises
    ------
    RecordingError
        If the folder exists or cannot be made, the storage is unknown, or `rosbags` is missing.
    """
    with (
        _signals_set(stop or threading.Event()) as ended,
        BagWriter(Path(output), storage) as writer,
        _own_context() as context,
    ):
        start = reported = time.monotonic()
        node = Recorder(writer, topics, context=context)
        executor = make_executor(context)
        executor.add_node(node)
        try:
            while context.ok() and not ended.is_set():
                executor.spin_once(timeout_sec=LONGEST_WAIT)
                now = time.monotonic()
                if on_progress and now - reported >= PROGRESS_PERIOD:
                    reported = now
                    on_progress(Progress(now - start, writer.counts))
                if duration is not None and now - start >= duration:
                    break
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()
            node.destroy_node()
        return Progress(time.monotonic() - start, writer.counts)


@contextmanager
def _own_context() -> Iterator[Any]:
    """Open an rclpy context beside any the process has, without signal handlers of rclpy's."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


@contextmanager
def _signals_set(event: threading.Event) -> Iterator[threading.Event]:
    """Let SIGINT and SIGTERM set `event` instead of interrupting a write (main thread only)."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = [signal.signal(number, lambda *_: event.set()) for number in numbers]
    try:
        yield event
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


class _Lines:
    """One live line on a terminal, nothing elsewhere."""

    erase: ClassVar[str] = '\r\x1b[K'

    def __call__(self, progress: Progress) -> None:
        """Show the figures."""
        print(
            f'{self.erase}recording: {progress.elapsed:.0f} s, {progress.messages} messages on '
            f'{len(progress.counts)} topics (Ctrl-C ends)',
            end='',
            file=sys.stderr,
            flush=True,
        )


def run(output: Path, topics: Sequence[str], storage: str, quiet: bool = False) -> int:
    """Record as ``tdm record`` does, with a live line; returns the exit code of the process."""
    live = sys.stderr.isatty() and not quiet
    try:
        done = record(output, topics, storage, on_progress=_Lines() if live else None)
    except RecordingError as error:
        print(f'error: {error}', file=sys.stderr)
        return 2
    if live:
        print(file=sys.stderr)
    if not quiet:
        print(f'{done.messages} messages in {done.elapsed:.1f} s written to {output}')
        for topic, count in sorted(done.counts.items()):
            print(f'  {count:8d}  {topic}')
    return 0

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""How a recording ends, and nodes whose executor is interrupted."""

from collections.abc import Callable, Iterable
import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

from bag_contents import fill, numbers, read_with_mcap
import pytest
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String
from stepped_ros import Stepped
from tdm_sim import recorder
from tdm_sim.bag_writer import BagWriter
from tdm_sim.recorder import IncompleteRecording, record

Publish = Callable[[Iterable[str]], None]


@pytest.fixture
def publish(stepped: Stepped, monkeypatch: pytest.MonkeyPatch) -> Publish:
    """Return what publishes texts on /texts, one whenever a recorder looks; then 10 ms pass."""

    def prepare(texts: Iterable[str]) -> None:
        publisher = stepped.node.create_publisher(String, '/texts', 100)
        remaining = iter(texts)

        def with_texts(context: Any) -> Any:
            executor = SingleThreadedExecutor(context=context)

            def spin_once(timeout_sec: float) -> None:
                stepped.step_to(stepped.now + 10_000_000)
                if publisher.get_subscription_count():
                    publisher.publish(String(data=next(remaining)))
                executor.spin_once(timeout_sec=timeout_sec)

            also = {name: getattr(executor, name) for name in ('add_node', 'shutdown')}
            return SimpleNamespace(spin_once=spin_once, **also)

        monkeypatch.setattr(recorder, 'make_executor', with_texts)

    return prepare


def test_a_recording_that_fills_the_disk_ends_with_a_reason_and_a_whole_bag(
    publish, tmp_path, monkeypatch
):
    enter = BagWriter.__enter__
    monkeypatch.setattr(BagWriter, '__enter__', lambda self: fill(enter(self), 3_000_000))
    publish(f'{k:06d}' + 'x' * 40_000 for k in range(10_000))
    with pytest.raises(IncompleteRecording, match=r'No space left.*; the recording') as caught:
        record(tmp_path / 'bag', ['/texts'])
    found = numbers(read_with_mcap(tmp_path / 'bag')['/texts'])
    assert len(found) > 50
    assert found == list(range(found[0], found[0] + len(found)))
    assert f'with {len(found)} messages' in str(caught.value)
    assert caught.value.progress.messages == len(found)


@pytest.mark.parametrize(
    ('ending', 'code'),
    [
        *((f'os.kill(os.getpid(), signal.{name})', 0) for name in ('SIGINT', 'SIGTERM')),
        ("rclpy.shutdown(); raise RuntimeError('the context is gone')", 0),
        ("raise RuntimeError('something broke')", 1),
    ],
)
def test_an_end_while_the_executor_takes_up_a_new_publisher(stepped, ending, code):
    """An executor interrupted there is left with half of its callbacks, and aborts when freed."""
    program = f"""
import os, rclpy, signal, sys
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from std_msgs.msg import String
from tdm_planner.nodes.runtime import run

class Late(Node):
    def __init__(self):
        super().__init__('late')
        self.create_timer(0.2, self.publish)

    def publish(self):
        taken_up, original = [], EventHandler.get_num_entities
        def get_num_entities(handler):
            taken_up.append(handler)
            if len(taken_up) == 2:
                {ending}
            return original(handler)
        EventHandler.get_num_entities = get_num_entities
        for name in 'abc':
            self.create_publisher(String, name, 1)

sys.exit(run(Late))
"""
    done = subprocess.run(
        [sys.executable, '-c', program],
        env={**os.environ, **stepped.environment},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == code, done.stderr
    assert 'Traceback' not in done.stderr
    assert ('fatal: RuntimeError: something broke' in done.stderr) == (code == 1)

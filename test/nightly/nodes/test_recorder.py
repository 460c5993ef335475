# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""How a recording ends, and nodes whose executor is interrupted."""

from concurrent.futures import ThreadPoolExecutor
from itertools import count
import os
import subprocess
import sys
from threading import Event

from bag_contents import fill, numbers, read_with_mcap
import pytest
from std_msgs.msg import String
from tdm_sim.recorder import IncompleteRecording, record


def test_a_recording_that_fills_the_disk_has_a_reason_and_a_whole_bag(ros, tmp_path, monkeypatch):
    ended = Event()
    fill(monkeypatch, 3_000_000)
    publisher, number = ros.node.create_publisher(String, '/texts', 100), count()

    def publish() -> None:
        while not ended.wait(0.01):
            publisher.publish(String(data=f'{next(number):06d}' + 'x' * 40_000))

    with ThreadPoolExecutor(1) as pool:
        pool.submit(publish)
        try:
            with pytest.raises(IncompleteRecording, match=r'No space left.*; the recording') as of:
                record(tmp_path / 'bag', ['/texts'])
        finally:
            ended.set()
    found = numbers(read_with_mcap(tmp_path / 'bag')['/texts'])
    assert len(found) > 50
    assert found == list(range(found[0], found[0] + len(found)))
    assert f'with {len(found)} messages' in str(of.value)


@pytest.mark.parametrize(
    ('ending', 'code'),
    [
        *((f'os.kill(os.getpid(), signal.{name})', 0) for name in ('SIGINT', 'SIGTERM')),
        ("rclpy.shutdown(); raise RuntimeError('the context is gone')", 0),
        ("raise RuntimeError('something broke')", 1),
    ],
)
def test_an_end_while_the_executor_takes_up_a_new_publisher(ros, ending, code):
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
    told = {'capture_output': True, 'text': True, 'env': {**os.environ, **ros.environment}}
    done = subprocess.run([sys.executable, '-c', program], timeout=60, **told)
    assert done.returncode == code, done.stderr
    assert 'Traceback' not in done.stderr
    assert ('fatal: RuntimeError: something broke' in done.stderr) == (code == 1)

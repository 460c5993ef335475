# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The end of nodes as real processes: what an executor that is interrupted would bring about."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from ros_harness import Ros


@pytest.mark.parametrize(
    ('ending', 'code'),
    [
        ('os.kill(os.getpid(), signal.SIGINT)', 0),
        ('os.kill(os.getpid(), signal.SIGTERM)', 0),
        ("rclpy.shutdown(); raise RuntimeError('the context is gone')", 0),
        ("raise RuntimeError('something broke')", 1),
    ],
)
def test_an_end_while_the_executor_takes_up_a_new_publisher(
    ros: Ros, ending: str, code: int
) -> None:
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
        env={**os.environ, **ros.environment},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == code, done.stderr
    assert 'Traceback' not in done.stderr
    assert ('fatal: RuntimeError: something broke' in done.stderr) == (code == 1)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys

import pytest
from ros_harness import NodeProcess, Ros
from std_srvs.srv import Trigger


def start(ros: Ros, name: str, *arguments: str) -> NodeProcess:
    path = os.pathsep.join([str(Path(__file__).parent), ros.environment['PYTHONPATH']])
    return ros.start(
        'example_node',
        arguments=['-r', f'__node:={name}', *arguments],
        environment={'PYTHONPATH': path},
    )


def run_program(ros: Ros, program: str) -> subprocess.CompletedProcess[str]:
    """Run a program of its own to its end."""
    return subprocess.run(
        [sys.executable, '-c', program],
        env={**os.environ, **ros.environment},
        capture_output=True,
        text=True,
        timeout=30,
    )


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_process_with_code_0(ros: Ros, number: signal.Signals) -> None:
    process = start(ros, f'ended_by_{number.name.lower()}')
    ros.call(f'ended_by_{number.name.lower()}/values', Trigger)
    assert process.end(number) == 0
    assert 'Traceback' not in process.output
    assert 'fatal' not in process.output


def test_others_see_at_once_that_it_has_gone(ros: Ros) -> None:
    """Not when the middleware gives it up, 20 s later."""
    process = start(ros, 'gone')
    ros.call('gone/values', Trigger)
    assert ros.node.count_services(ros.node.resolve_service_name('gone/values')) == 1
    process.end_cleanly()
    assert ros.spin_until(lambda: not ros.node.count_services('/gone/values'), 10.0)


def test_two_interrupts_in_a_row_end_it_as_cleanly(ros: Ros) -> None:
    process = start(ros, 'twice')
    ros.call('twice/values', Trigger)
    os.killpg(process.process.pid, signal.SIGINT)
    assert process.end(signal.SIGINT) == 0
    assert 'Traceback' not in process.output


@pytest.mark.parametrize('when', ['in a finaliser', 'while it leaves'])
def test_signals_while_the_node_is_made(ros: Ros, when: str) -> None:
    """Raised anywhere, as Python does it, one would be told as ignored, or come too late."""
    program = f"""
import os, signal, sys
from rclpy.node import Node
from tdm_planner.nodes import runtime

def twice():
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGINT)

class Finalised:
    def __del__(self):
        twice()

class Starting(Node):
    def __init__(self):
        super().__init__('starting')
        if {when == 'in a finaliser'}:
            Finalised()
        else:
            ignore = runtime.EndRequest.ignore
            runtime.EndRequest.ignore = lambda end: (twice(), ignore(end))
            twice()

sys.exit(runtime.run(Starting))
"""
    done = run_program(ros, program)
    assert (done.returncode, done.stderr) == (0, '')


def test_what_was_loaded_is_not_looked_through_for_garbage(ros: Ros) -> None:
    """That takes .1 s with what a tracker loads, in which it sends no command."""
    program = """
import gc, sys
from rclpy.node import Node
from tdm_planner.nodes import runtime

class Loaded(Node):
    def __init__(self):
        super().__init__('loaded')
        self.many = [[] for _ in range(100_000)]
        self.create_timer(0.01, self.look)

    def look(self):
        print(len(gc.get_objects()) < 100_000, flush=True)
        raise RuntimeError('enough')

runtime.run(Loaded)
"""
    assert run_program(ros, program).stdout == 'True\n'


def test_a_computation_under_way_does_not_hold_the_end_up(ros: Ros) -> None:
    process = start(ros, 'computing')
    ros.call('computing/compute', Trigger)
    assert process.end(timeout=5.0) == 0
    assert 'Traceback' not in process.output


def test_an_error_in_a_callback_is_one_line(ros: Ros) -> None:
    process = start(ros, 'failing')
    ros.request('failing/fail', Trigger)
    assert process.process.wait(10.0) == 1
    assert 'fatal: RuntimeError: something broke\n' in process.output
    assert 'Traceback' not in process.output


def test_a_missing_parameter_file_is_one_line(ros: Ros) -> None:
    process = start(ros, 'no_file', '--params-file', '/nowhere.yaml')
    assert process.process.wait(10.0) == 1
    assert '/nowhere.yaml' in process.output
    assert 'Traceback' not in process.output


@pytest.mark.parametrize(('ended', 'code'), [(True, 0), (False, 1)])
def test_an_error_counts_unless_the_process_was_asked_to_end(
    ros: Ros, ended: bool, code: int
) -> None:
    """As when a signal interrupts rclpy while it takes a message."""
    program = f"""
import rclpy, sys
from rclpy.node import Node
from tdm_planner.nodes.runtime import run

class Failing(Node):
    def __init__(self):
        super().__init__('failing')
        self.create_timer(0.01, self.fail)

    def fail(self):
        if {ended}:
            rclpy.shutdown()
        raise RuntimeError('interrupted')

sys.exit(run(Failing))
"""
    done = run_program(ros, program)
    assert done.returncode == code, done.stderr
    assert ('fatal' in done.stderr) == (code == 1)


def test_a_signal_that_rclpy_turns_into_an_error_of_its_own(ros: Ros) -> None:
    """Seen on a busy machine: an interrupted conversion raises before the context is down."""
    program = """
import os, rclpy, signal, sys
from rclpy.node import Node
from tdm_planner.nodes.runtime import run

class Converting(Node):
    def __init__(self):
        super().__init__('converting')
        self.create_timer(0.01, self.convert)

    def convert(self):
        rclpy.ok = lambda: True
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            pass
        raise RuntimeError("Unable to convert call argument '0' to Python object")

sys.exit(run(Converting))
"""
    done = run_program(ros, program)
    assert done.returncode == 0, done.stderr
    assert 'fatal' not in done.stderr


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
    done = run_program(ros, program)
    assert done.returncode == code, done.stderr
    assert 'Traceback' not in done.stderr
    assert ('fatal: RuntimeError: something broke' in done.stderr) == (code == 1)

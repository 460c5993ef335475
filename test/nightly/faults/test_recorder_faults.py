# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A disk that gets full while ``tdm record`` records a plant: over DDS, with the real command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import subprocess
import sys
import time

import pytest
from ros_harness import Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes.messages import nanoseconds_of

highlevel = pytest.importorskip('rosbags.highlevel')

PATIENCE = 90.0  # s
ROOM = 11 * 2**20  # bytes, of which the recorder keeps 8 MB in reserve
FILLER = 'x' * 10_000


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Path]:
    """Yield a folder on a disk of `ROOM` bytes."""
    folder = tmp_path / 'small'
    folder.mkdir()
    command = ['mount', '-t', 'tmpfs', '-o', f'size={ROOM}', 'tmpfs', str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip('mounting is not permitted here')
    yield folder
    subprocess.run(['umount', str(folder)], check=True)


def test_the_recording_ends_with_a_reason_and_the_plant_does_not_notice(
    ros: Ros, small: Path
) -> None:
    space = 'filling'
    ros.start('tdm_sim.pendulum_plant', namespace=space)
    states = ros.subscribe(f'/{space}/joint_states', JointState, 1000)
    filler = ros.node.create_publisher(String, f'/{space}/filler', 100)
    output = small.parent / f'{space}.txt'
    with output.open('w') as file:
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'tdm_planner.cli', 'record', '-o', str(small / 'bag'),
             f'/{space}/joint_states', f'/{space}/filler'],
            stdout=file,
            stderr=file,
        )  # fmt: skip
    try:
        assert ros.spin_until(lambda: bool(states) and filler.get_subscription_count() > 0, 90.0)
        begun, deadline = len(states), time.monotonic() + PATIENCE
        while recorder.poll() is None and time.monotonic() < deadline:
            filler.publish(String(data=FILLER))
            ros.spin_for(0.002)
        assert recorder.poll() == 1, output.read_text()
        known = len(states)
        assert ros.spin_until(lambda: len(states) > known + 50, PATIENCE)
    finally:
        if recorder.poll() is None:
            recorder.kill()
        recorder.wait()
    said = output.read_text()
    assert 'Traceback' not in said
    (error,) = (line for line in said.splitlines() if line.startswith('error: '))
    assert 'No space left on device; the recording ends' in error
    with highlevel.AnyReader([small / 'bag']) as reader:  # it is whole
        found = [connection.topic for connection, _, _ in reader.messages()]
    assert f'with {len(found)} messages' in said
    assert f'/{space}/joint_states' in found
    stamps = [nanoseconds_of(state.header.stamp) for state in states[begun:]]
    assert stamps == sorted(stamps)

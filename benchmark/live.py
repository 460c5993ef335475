# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The page `tdm live` beside its nodes: frames, and commands.

The nodes of the pendulum run at 200 Hz, with replanning at 5 Hz while it is pushed twice a second.
Many robots, two processes each, are more than two cores bear: their states are played at 25 Hz by
one process, while their planner is asked for a plan five times a second. First without the page,
then with it and a connection that takes all that a browser takes, but draws nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import re
import tempfile
import threading
import time
from typing import Any

from benchmark.measuring import report
from benchmark.nodes import PUSHED, Rig, START
from benchmark.scenarios import crossing
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import joint_states, odometry
from tdm_planner.plant_kind import ROBOT
from tdm_sim.processes import NodeProcesses
import viser
from websockets.sync.client import connect
import zstandard

PLAYED = 0.04  # s between states of robots
PLANNER = {'replan.rate': 5.0, 'solver.deadline': 0.9, 'start.delay': START}


class Played(Rig):
    """The planner of robots, whose states are played."""

    every = 0.2  # s between plans
    executables = ('planner',)

    def begin(self) -> None:
        """Wait until the planner is there."""
        make = self._node.create_publisher
        self._publishers = [
            (make(JointState, f'{space}/joint_states', 1), make(Odometry, f'{space}/odom', 1))
            for space in self._spaces
        ]
        self._node.create_timer(PLAYED, self._play)
        self._wait(self._plan.service_is_ready)

    def _play(self) -> None:
        """Publish robots that go round in circles."""
        now = self._node.get_clock().now()
        turn = 0.5 * now.nanoseconds * 1e-9
        joints = [joint for joint in ROBOT.joints if joint.name not in ROBOT.odometry]
        values = dict.fromkeys((*ROBOT.state_names, *ROBOT.control_names), 0.5)
        for number, (space, publishers) in enumerate(
            zip(self._spaces, self._publishers, strict=True)
        ):
            values |= {'x': 0.6 * number + np.cos(turn), 'y': 2.0 + np.sin(turn), 'yaw': turn}
            states = joint_states(joints, values)
            states.header.stamp = now.to_msg()
            name = space.rpartition('/')[2]
            place = odometry(ROBOT, values, dict.fromkeys(values, 0.0), now.to_msg(), name)
            for publisher, message in zip(publishers, (states, place), strict=True):
                publisher.publish(message)

    def reset(self) -> None:
        """Do nothing: plans begin at the parameters' start."""

    def act(self) -> None:
        """Ask for a plan."""
        self._plan.call_async(Trigger.Request())


class Viewer:
    """A connection to a page, as a browser has; `frames` are the instants [s] of pictures."""

    def __init__(self, address: str) -> None:
        self.frames: list[float] = []
        self._connection = connect(
            address.replace('http', 'ws'),
            subprotocols=[f'viser-v{viser.__version__}'],  # type: ignore[list-item]
            max_size=None,
            proxy=None,
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor().decompress
        for data in self._connection:
            assert isinstance(data, bytes)
            packed = int.from_bytes(data[8:16], 'little')
            told = unpack(data[16:][:packed])  # messages as msgpack, by name
            if b'/plants/' in told and b'batched_positions' in told:
                self.frames.append(time.monotonic())

    def close(self) -> None:
        """Leave the page."""
        self._connection.close()
        self._thread.join()


@contextmanager
def page_on(space: str, folder: Path) -> Iterator[tuple[int, str]]:
    """Serve the page on the nodes of a namespace; yields its process and address."""
    words = ['live', space, '--no-browser', '--port', '0', '-o', str(folder)]
    with NodeProcesses(folder) as processes:
        processes.start('page', 'tdm_planner.cli', words)
        found = None
        while found is None:
            processes.check()
            time.sleep(0.1)
            found = re.search(r'http://\S+', (folder / 'page.log').read_text())
        yield processes.identifiers['page'], found[0]


def processor_time(process: int) -> float:
    """Return the processor time that a process has taken [s]."""
    fields = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def beside(
    made: type[Rig], plant: str, parameters: Mapping[str, Any], seconds: float
) -> dict[str, Any]:
    """Return the figures of one plant, without the page and with it."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report(f'{plant}: nodes')
        rig = made(plant, parameters, folder)
        stack.callback(rig.close)
        rig.begin()
        report(f'{plant}: without the page, for {seconds:g} s')
        without, _ = rig.measure(seconds)
        process, address = stack.enter_context(page_on(rig.space, folder))
        viewer = Viewer(address)
        stack.callback(viewer.close)
        while len(viewer.frames) < 2:
            rig.spin(0.1)
        report(f'{plant}: with the page, for {seconds:g} s')
        first, busy = len(viewer.frames), processor_time(process)
        periods, plans = rig.measure(seconds)
        frames = np.diff(viewer.frames[first:])
        spent = viewer.frames[-1] - viewer.frames[first]
        return {
            'frames_per_s': float(1.0 / frames.mean()),
            'frame_p99_ms': float(1e3 * np.quantile(frames, 0.99)),
            'plans_per_s': plans / seconds,
            'page_processor_share': (processor_time(process) - busy) / spent,
            'period_p99_ms': {
                how: float(np.quantile(np.abs(found - 5.0), 0.99))
                for how, found in (('without', without), ('with', periods))
                if found.size
            },
        }


def run(seconds: float = 20.0, robots: int = 12) -> dict[str, Any]:
    """Measure the pendulum, and so many robots, each for `seconds` without and with the page."""
    pendulum = {**PUSHED, 'planner': {**PUSHED['planner'], **PLANNER}}
    crossed = crossing(0, robots).parameters(problem='robot_formation')
    asked = {**crossed, **PLANNER, 'start.source': 'parameters'}
    return {
        'pendulum': beside(Rig, 'pendulum', pendulum, seconds),
        'robots': beside(Played, 'robots', {'planner': asked}, seconds),
    }


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    lines = [
        f'{"":10}{"frames/s":>10}{"p99 [ms]":>10}{"plans/s":>9}{"page, core":>12}'
        f'{"error of the period, p99 [ms]":>32}'
    ]
    for plant, f in figures.items():
        errors = ', '.join(f'{how} {value:.2f}' for how, value in f['period_p99_ms'].items())
        lines.append(
            f'{plant:10}{f["frames_per_s"]:10.1f}{f["frame_p99_ms"]:10.0f}{f["plans_per_s"]:9.1f}'
            f'{100 * f["page_processor_share"]:10.0f} %{errors:>32}'
        )
    return '\n'.join(lines)

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

"""
Put load on running nodes: 20 clients that ask for plans without a pause, or 12 robots.

    python -m tools.load clients [--seconds 60] [--clients 20]
    python -m tools.load robots [--seconds 20] [--robots 12]

Clients: is every call answered, are those refused as BUSY refused at once, does the planner's
memory stay flat, and is the stream of commands at 200 Hz disturbed? Robots: which rates do plants
and trackers hold beside a planner, and do they say so in their diagnostics where they do not?
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import signal
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.context import Context
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.exceptions import TdmError
from tdm_planner.nodes.qos import NEWEST, SERVICE
from tdm_planner.nodes.runtime import make_executor
from tdm_sim.processes import NodeProcesses
from tools.memory import resident
from tools.priority import make_real_time

RATE = 200.0  # Hz, of commands and states
_UP_LIMIT = 60.0  # s
_LAST_ANSWERS = 10.0  # s for what is under way at the end
_SETTLING = 3.0  # s
_DOMAIN = '74'
_COMMANDS = '/pendulum/joint_command'
_PLANNER, _TRACKER = 'tdm_planner.nodes.planner', 'tdm_planner.nodes.tracker'
_PENDULUM, _ROBOT = 'tdm_sim.pendulum_plant', 'tdm_sim.robot_plant'


class NotUp(Exception):
    """Nodes did not come up in time; says which."""


class Bench:
    """A node that talks to the nodes under load. A context manager."""

    def __init__(self, processes: NodeProcesses, name: str = 'load') -> None:
        self._processes = processes
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, context=self._context)
        self._executor = make_executor(self._context)
        self._executor.add_node(self.node)

    def wait(self, until: Callable[[], bool], limit: float) -> bool:
        """Serve messages until `until()` holds; False when `limit` s have passed."""
        end = time.monotonic() + limit
        next_check = 0.0
        while not until():
            now = time.monotonic()
            if now > end:
                return False
            if now > next_check:
                next_check = now + 0.5
                self._processes.check()
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def spin(self, seconds: float) -> None:
        """Serve messages for a while."""
        self.wait(lambda: False, seconds)

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@dataclass
class Calls:
    """What became of the calls of one client."""

    asked: int = 0
    codes: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, list[float]] = field(default_factory=dict)

    def answered(self, code: str, seconds: float) -> None:
        """Note an answer."""
        self.codes[code] = self.codes.get(code, 0) + 1
        self.seconds.setdefault(code, []).append(seconds)


class Client:
    """Calls `plan` again as soon as it has been answered."""

    def __init__(self, bench: Bench, namespace: str) -> None:
        self.calls = Calls()
        self.waiting = False
        self.stopped = False
        self.service = bench.node.create_client(Trigger, f'{namespace}/plan', qos_profile=SERVICE)

    def ask(self) -> None:
        """Send a request; its answer sends the next."""
        self.waiting = True
        self.calls.asked += 1
        began = time.monotonic()

        def answered(future: Any) -> None:
            response = future.result()
            code = 'PLAN' if response.success else json.loads(response.message)['code']
            self.calls.answered(code, time.monotonic() - began)
            self.waiting = False
            if not self.stopped:
                self.ask()

        self.service.call_async(Trigger.Request()).add_done_callback(answered)


def clients(seconds: float, count: int, folder: Path, real_time: int = 0) -> dict[str, Any]:
    """
    Ask for plans with many clients at once and return the figures.

    `real_time` is the priority of plant and tracker, as on a robot's computer; 0 for none.
    """
    with NodeProcesses(folder) as processes:
        processes.start(
            'probe',
            'tools.stream_probe',
            ['--all', str(folder / 'stream.npz'), f'{_COMMANDS}=JointState'],
        )
        for name, module in (('plant', _PENDULUM), ('tracker', _TRACKER), ('planner', _PLANNER)):
            processes.start(name, module, ['--ros-args', '-r', '__ns:=/pendulum'])
        quick = {name: processes.identifiers[name] for name in ('plant', 'tracker')}
        make_real_time(quick, real_time, and_this=False)
        with Bench(processes) as bench:
            heard: list[JointState] = []
            bench.node.create_subscription(
                JointState,
                _COMMANDS,
                lambda message: heard.append(message) if not heard else None,
                NEWEST,
            )
            asking = [Client(bench, '/pendulum') for _ in range(count)]
            first = asking[0]
            if not bench.wait(
                lambda: bool(heard) and all(c.service.service_is_ready() for c in asking),
                _UP_LIMIT,
            ):
                raise NotUp('pendulum: no commands, or no service plan')
            bench.spin(_SETTLING)
            first.stopped = True
            first.ask()  # what is loaded with the first plan is no growth
            bench.wait(lambda: not first.waiting, _UP_LIMIT)
            # The stream is written down by another process: this one will be too busy.
            undisturbed = time.time(), time.time() + min(seconds / 2, 10.0)
            bench.spin(undisturbed[1] - undisturbed[0])
            first.calls, first.stopped = Calls(), False
            planner = processes.identifiers['planner']
            memory = [resident(planner)]
            disturbed = time.time(), time.time() + seconds
            for client in asking:
                client.ask()
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                bench.spin(1.0)
                memory.append(resident(planner))
            for client in asking:
                client.stopped = True
            bench.wait(lambda: not any(c.waiting for c in asking), _LAST_ANSWERS)
        processes.end()
    with np.load(folder / 'stream.npz') as recorded:
        stamps = recorded[_COMMANDS][:, 0]
    return {
        'clients': count,
        'seconds': seconds,
        **_calls(asking),
        'memory [MB]': {
            'first': memory[0],
            'half way': memory[len(memory) // 2],
            'last': memory[-1],
        },
        'period error without load [ms]': _errors(stamps, undisturbed),
        'period error under load [ms]': _errors(stamps, disturbed),
    }


def _calls(asking: Sequence[Client]) -> dict[str, Any]:
    codes: dict[str, int] = {}
    times: dict[str, list[float]] = {}
    for client in asking:
        for code, number in client.calls.codes.items():
            codes[code] = codes.get(code, 0) + number
            times.setdefault(code, []).extend(client.calls.seconds[code])
    asked = sum(client.calls.asked for client in asking)
    return {
        'asked': asked,
        'unanswered': asked - sum(codes.values()),
        'answers': codes,
        'latency [ms]': {
            code: {f'p{p}': 1e3 * float(np.quantile(found, p / 100)) for p in (50, 99, 100)}
            for code, found in times.items()
        },
    }


def _errors(stamps: NDArray[np.float64], window: tuple[float, float]) -> dict[str, float]:
    """Return how far the times between commands, by their own stamps, are from the period [ms]."""
    stamps = stamps[(stamps >= window[0]) & (stamps <= window[1])]
    if len(stamps) < 3:
        return {'p50': float('nan'), 'p99': float('nan'), 'worst': float('nan')}
    error = 1e3 * np.abs(np.diff(stamps) - 1.0 / RATE)
    return {
        'p50': float(np.median(error)),
        'p99': float(np.quantile(error, 0.99)),
        'worst': float(error.max()),
        'commands': float(len(stamps)),
        'expected': RATE * (window[1] - window[0]),
    }


def robots(seconds: float, count: int, folder: Path) -> dict[str, Any]:
    """Run many robots with trackers beside a planner and return their rates."""
    names = [f'robot{k + 1}' for k in range(count)]
    with NodeProcesses(folder) as processes:
        for k, name in enumerate(names):
            space = ['--ros-args', '-r', f'__ns:=/robots/{name}']
            place = ['-p', f'initial.x:={0.5 + k % 4:g}', '-p', f'initial.y:={0.5 + k // 4:g}']
            processes.start(f'plant_{name}', _ROBOT, [*space, *place])
            processes.start(f'tracker_{name}', _TRACKER, [*space, '-p', 'kind:=robot'])
        processes.start(
            'planner',
            _PLANNER,
            ['--ros-args', '-r', '__ns:=/robots', '-p', 'problem:=robot_formation'],
        )
        with Bench(processes) as bench:
            seen: dict[str, dict[str, Any]] = {}

            def on_diagnostics(message: DiagnosticArray) -> None:
                for status in message.status:
                    values = {item.key: item.value for item in status.values}
                    seen[status.hardware_id] = {
                        'level': int.from_bytes(status.level, 'little'),
                        'message': status.message,
                        'rate': float(values.get('rate [Hz]', 'nan')),
                    }

            bench.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 100)
            wanted = {f'/robots/{n}/{kind}' for n in names for kind in ('robot_plant', 'tracker')}
            if not bench.wait(lambda: wanted <= set(seen), 3 * _UP_LIMIT):
                raise NotUp(f'no diagnostics from {", ".join(sorted(wanted - set(seen)))}')
            bench.spin(seconds)
    rates = {name: seen[name]['rate'] for name in sorted(wanted)}
    slow = {name: rate for name, rate in rates.items() if rate < 0.9 * RATE}
    return {
        'robots': count,
        'rate [Hz]': {'least': min(rates.values()), 'median': float(np.median([*rates.values()]))},
        'below 90 %': len(slow),
        'of which silent about it': sorted(n for n in slow if not told_slow(seen[n])),
        'for example': next((seen[n]['message'] for n in slow), ''),
    }


def told_slow(status: Mapping[str, Any]) -> bool:
    """Whether a diagnostic status is a warning, or worse, that speaks of the rate."""
    return status['level'] > 0 and 'Hz instead of' in status['message']


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    kinds = parser.add_subparsers(dest='kind', required=True)
    asked = kinds.add_parser('clients')
    asked.add_argument('--seconds', type=float, default=60.0)
    asked.add_argument('--clients', type=int, default=20)
    asked.add_argument(
        '--real-time', type=int, default=0, metavar='LEVEL',
        help='real-time priority of plant and tracker (0: none)',
    )  # fmt: skip
    many = kinds.add_parser('robots')
    many.add_argument('--seconds', type=float, default=20.0)
    many.add_argument('--robots', type=int, default=12)
    given = parser.parse_args(arguments)
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background SIGINT is ignored
        signal.signal(number, signal.default_int_handler)
    os.environ.setdefault('ROS_DOMAIN_ID', _DOMAIN)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with TemporaryDirectory() as folder:
        os.environ.setdefault('ROS_LOG_DIR', folder)
        try:
            figures = (
                clients(given.seconds, given.clients, Path(folder), given.real_time)
                if given.kind == 'clients'
                else robots(given.seconds, given.robots, Path(folder))
            )
        except (NotUp, TdmError) as error:
            print(f'load: {error}', file=sys.stderr)
            return 1
    print(json.dumps(figures, indent=1))
    return 0


if __name__ == '__main__':
    sys.exit(main())

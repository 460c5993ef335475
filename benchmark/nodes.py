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
Figures of the planner as a node, over DDS: start-up, latency, memory, deadline.

    python benchmark/nodes.py [--states N] [--json FILE]

A planner runs in a process of its own; latencies are from sending a request of the `plan` service
to receiving its answer, for the random states of `pendulum.py` given by the start.* parameters.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import json
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

if __package__ in (None, ''):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmark.pendulum import REGIMES, start_state  # noqa: I100
from benchmark.progress import counted  # noqa: I100
from benchmark.ros_domain import reserved_domain  # noqa: I100

_LONGEST = 120.0  # s without an answer
_HOPELESS_TORQUE = 1e-4  # N m
_DEADLINES = (0.1, 0.3, 0.5, 1.0)  # s
_NAMES = ('theta', 'psi', 'theta_dot', 'psi_dot')


class PlannerProcess:
    """A planner in a process of its own, and a node here that asks it."""

    def __init__(self, parameters: Mapping[str, Any], domain: int, folder: Path) -> None:
        arguments = [f'{name}:={value}' for name, value in parameters.items()]
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node('benchmark', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._plan = self._node.create_client(Trigger, 'plan')
        self._set = self._node.create_client(
            SetParametersAtomically, 'planner/set_parameters_atomically'
        )
        self.started = time.perf_counter()
        with (folder / 'planner.txt').open('w') as output:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'tdm_planner.nodes.planner', '--ros-args']
                + [word for argument in arguments for word in ('-p', argument)],
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def plan(self) -> tuple[float, dict[str, Any]]:
        """Request a plan; returns the latency [s] and the answer."""
        began = time.perf_counter()
        response = self._call(self._plan, Trigger.Request())
        return time.perf_counter() - began, json.loads(response.message)

    def set(self, values: Mapping[str, Any]) -> None:  # noqa: A003
        """Set parameters."""
        request = SetParametersAtomically.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        result = self._call(self._set, request).result
        if not result.successful:
            raise RuntimeError(result.reason)

    def memory(self) -> tuple[float, float]:
        """Resident memory now and at its peak [MB]."""
        status = Path(f'/proc/{self._process.pid}/status').read_text()
        fields = dict(line.split(':', 1) for line in status.splitlines())
        now, peak = (float(fields[name].split()[0]) / 1024 for name in ('VmRSS', 'VmHWM'))
        return now, peak

    def close(self) -> None:
        """End the planner, which must exit with code 0."""
        self._process.send_signal(signal.SIGINT)
        code = self._process.wait(10.0)
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
        if code != 0:
            raise RuntimeError(f'the planner ended with code {code}')

    def _call(self, client: Any, request: Any) -> Any:
        self._wait(client.service_is_ready, 0.005)
        future = client.call_async(request)
        self._wait(future.done, 0.1)
        return future.result()

    def _wait(self, done: Callable[[], bool], interval: float) -> None:
        end = time.monotonic() + _LONGEST
        while not done():
            if time.monotonic() > end or self._process.poll() is not None:
                raise RuntimeError('the planner does not answer')
            self._executor.spin_once(timeout_sec=interval)


@contextmanager
def planner(**parameters: Any) -> Iterator[PlannerProcess]:
    """Yield a planner with parameters (``__`` for the dot) that plans from start.*."""
    named = {name.replace('__', '.'): value for name, value in parameters.items()}
    with tempfile.TemporaryDirectory() as folder, reserved_domain(Path(folder)) as domain:
        made = PlannerProcess({'start.source': 'parameters', **named}, domain, Path(folder))
        try:
            yield made
        finally:
            made.close()


def latencies(torque: float, states: int) -> dict[str, Any]:
    """Cold requests for random states in one running planner."""
    seconds, codes = [], []
    with planner(limits__torque=torque, torque_reserve=0.0) as process:
        process.plan()
        for seed in counted(range(states), f'requests, torque limit {torque:g} N m'):
            state = start_state(seed).tolist()
            process.set({f'start.{name}': x for name, x in zip(_NAMES, state, strict=True)})
            latency, answer = process.plan()
            seconds.append(latency)
            codes.append(answer.get('code', 'PLAN'))
        memory, peak = process.memory()
    return {
        'states': states,
        'planned': codes.count('PLAN') / states,
        'failures': {code: codes.count(code) for code in sorted(set(codes) - {'PLAN'})},
        'median_ms': 1e3 * float(np.median(seconds)),
        'p95_ms': 1e3 * float(np.quantile(seconds, 0.95)),
        'slowest_ms': 1e3 * float(np.max(seconds)),
        'memory_mb': memory,
        'peak_memory_mb': peak,
    }


def first_answers(count: int) -> list[float]:
    """Return the times from starting the process to its first answer [s], discovery included."""
    found = []
    for _ in counted(range(count), 'starts of the process'):
        with planner(limits__torque=REGIMES['strong'], solver__deadline=5.0) as process:
            process.plan()
            found.append(time.perf_counter() - process.started)
    return found


def overruns(deadlines: tuple[float, ...] = _DEADLINES, repetitions: int = 3) -> dict[str, float]:
    """Latest answer after the deadline [ms] to requests that cannot be met."""
    late = {}
    with planner(limits__torque=_HOPELESS_TORQUE) as process:
        process.plan()
        for deadline in counted(deadlines, 'deadlines'):
            process.set({'solver.deadline': deadline})
            worst = max(process.plan()[0] for _ in range(repetitions))
            late[f'{deadline:g}'] = 1e3 * (worst - deadline)
    return late


def run(states: int = 100, starts: int = 5, repetitions: int = 3) -> dict[str, Any]:
    """Measure everything."""
    return {
        'first_answer_s': first_answers(starts),
        'overrun_ms': overruns(repetitions=repetitions),
        **{regime: latencies(torque, states) for regime, torque in REGIMES.items()},
    }


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    first = figures['first_answer_s']
    lines = [
        f'process start to first answer: {np.median(first):.2f} s (slowest {max(first):.2f} s)',
        'answers after the deadline: '
        + ', '.join(f'{late:.0f} ms at {d} s' for d, late in figures['overrun_ms'].items()),
        f'{"":8}{"planned":>9}{"ms med":>8}{"ms p95":>8}{"ms max":>8}{"MB":>7}{"MB peak":>9}',
    ]
    for regime in REGIMES:
        f = figures[regime]
        lines.append(
            f'{regime:8}{f["planned"]:9.1%}{f["median_ms"]:8.0f}{f["p95_ms"]:8.0f}'
            f'{f["slowest_ms"]:8.0f}{f["memory_mb"]:7.0f}{f["peak_memory_mb"]:9.0f}'
        )
        lines += [f'    {count} x {code}' for code, count in f['failures'].items()]
    return '\n'.join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--states', type=int, default=100, help='number of random states')
    parser.add_argument('--json', type=Path, help='also write the figures to this file')
    arguments = parser.parse_args()
    figures = run(arguments.states)
    print(table(figures))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + '\n')


if __name__ == '__main__':
    main()

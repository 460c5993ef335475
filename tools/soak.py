# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Ask one planner for swing-ups, by many clients, for as long as told: who is answered, what grows.

    python -m tools.soak --minutes 60 --clients 20

Planner, tracker and plant run as processes; the plant is reset every eight seconds. Printed are
the answers by their code, their latency, and the memory of every process half-way and at the end.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
import json
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any

from benchmark.measuring import resident
import numpy as np
import rclpy
from rclpy.context import Context
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.runtime import make_executor
from tdm_sim.processes import NodeProcesses

_NODES = {
    'pendulum_plant': 'tdm_sim.pendulum_plant',
    'tracker': 'tdm_planner.nodes.tracker',
    'planner': 'tdm_planner.nodes.planner',
}
_SETTLING = 3.0  # s
_UP, _SILENT = 60.0, 30.0  # s for the nodes to be up, and after which a call is unanswered
_SAMPLING, _FLIGHT = 1.0, 8.0  # s between looks at the memory, and of every mission


def soak(duration: float, clients: int, folder: Path) -> dict[str, Any]:
    """
    Let `clients` ask for plans for `duration` s.

    Returns how many calls got which answer ('' is none), the median and 99th percentile of their
    latency [s], and the memory [MB] of every process half-way and at the end.
    """
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('soak', namespace='/pendulum', context=context)
    executor = make_executor(context)
    executor.add_node(node)
    ask = [node.create_client(Trigger, 'plan', qos_profile=SERVICE) for _ in range(clients)]
    reset = node.create_client(Trigger, 'reset')
    late: dict[str, list[float]] = defaultdict(list)
    memory: dict[str, list[float]] = defaultdict(list)
    arguments = ['--ros-args', '-r', '__ns:=/pendulum']
    try:
        with NodeProcesses(folder) as processes:
            for name, module in _NODES.items():
                processes.start(name, module, arguments)
            began = time.monotonic()
            while not all(client.service_is_ready() for client in (*ask, reset)):
                assert time.monotonic() < began + _UP, 'the nodes are not up'
                executor.spin_once(timeout_sec=0.1)
            began = time.monotonic() + _SETTLING
            while time.monotonic() < began:  # until every client hears the planner, too
                executor.spin_once(timeout_sec=0.1)
            sampled = flown = began
            calls: list[Any] = [None] * clients
            while (now := time.monotonic()) < began + duration:
                for k, client in enumerate(ask):
                    if calls[k] is None or _answered(calls[k], now, late):
                        calls[k] = client.call_async(Trigger.Request()), now
                if now > flown:
                    flown = now + _FLIGHT
                    reset.call_async(Trigger.Request())
                if now > sampled:
                    sampled = now + _SAMPLING
                    processes.check()
                    for name, identifier in processes.identifiers.items():
                        memory[name].append(resident(identifier))
                executor.spin_once(timeout_sec=0.01)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    return {
        'answers': {code: len(times) for code, times in late.items()},
        'latency [s]': {c: np.quantile(times, (0.5, 0.99)).tolist() for c, times in late.items()},
        'memory [MB]': {n: (sizes[len(sizes) // 2], sizes[-1]) for n, sizes in memory.items()},
    }


def _answered(call: tuple[Any, float], now: float, late: dict[str, list[float]]) -> bool:
    """Take note of an answer, or of a call that has none after too long; False: wait for it."""
    future, asked = call
    if not future.done() and now < asked + _SILENT:
        return False
    response = future.result() if future.done() else None
    answer = {} if response is None else json.loads(response.message)
    late[answer.get('code', 'PLAN') if answer else ''].append(now - asked)
    return True


def main() -> None:
    """Soak and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--clients', type=int, default=1)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        found = soak(60.0 * options.minutes, options.clients, Path(folder))
    print(json.dumps(found, indent=1))


if __name__ == '__main__':
    main()

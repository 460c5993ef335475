# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes as processes, measured while their pendulum is pushed and plans are made at 5 Hz."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import os
from pathlib import Path
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_sim.processes import make_scene, NodeProcesses
import yaml

START = 1.0  # s from a request to the start of a motion
LONGEST = 300.0  # s until nodes answer
WEAK = {'limits.torque': 0.02}
PUSHED: Mapping[str, dict[str, Any]] = {  # parameters of the nodes
    'planner': {**WEAK, 'replan.rate': 5.0},
    'tracker': {**WEAK, 'replan.on_deviation': True},
    'pendulum_plant': {**WEAK, 'disturbance.impulse': 6e-4},
}


class Rig:
    """The nodes of a plant as processes, and one that listens."""

    every = 0.5  # s between pushes
    executables: tuple[str, ...] = ('planner', 'tracker', 'pendulum_plant')

    def __init__(self, plant: str, parameters: Mapping[str, Any], folder: Path) -> None:
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)  # the namespaces are anybody's
        file = folder / f'{plant}.yaml'
        sections = {f'/**/{name}': {'ros__parameters': v} for name, v in parameters.items()}
        file.write_text(yaml.safe_dump(sections))
        scene = make_scene(plant, file)
        self.space, self._spaces = scene.namespace, [part.namespace for part in scene.plants]
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node('benchmark', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.stamps: list[int] = []
        self.plans: list[String] = []

        def on_command(message: JointState) -> None:
            self.stamps.append(nanoseconds_of(message.header.stamp))

        make = self._node.create_subscription
        make(JointState, f'{self._spaces[0]}/joint_command', on_command, 1000)
        make(String, f'{self.space}/plan_summary', self.plans.append, 10)
        scene.listen(self._node)
        client = self._node.create_client
        self._plan = client(Trigger, f'{self.space}/plan')
        self._reset = client(Trigger, f'{self.space}/reset')
        self._push = client(Trigger, f'{self.space}/push')
        self._processes, self._scene = NodeProcesses(folder), scene
        for name, module, words in scene.nodes():
            if name in self.executables:
                self._processes.start(name, module, words)

    def begin(self) -> None:
        """Wait until the nodes are connected."""
        self._wait(lambda: not self._scene.missing())

    def _wait(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + LONGEST
        while not done():
            if time.monotonic() > end:
                raise RuntimeError(f'the nodes in {self.space} do not answer')
            self._processes.check()
            self._executor.spin_once(timeout_sec=0.1)

    def reset(self) -> None:
        """Begin anew."""
        self._wait(self._reset.call_async(Trigger.Request()).done)
        self.spin(0.1)  # until the planner has heard of it

    def act(self) -> None:
        """Do what new plans are made for."""
        self._push.call_async(Trigger.Request())

    def spin(self, seconds: float) -> None:
        """Serve what arrives for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)

    def measure(self, seconds: float) -> tuple[NDArray[np.float64], int]:
        """Push and plan for a while; returns the commands' periods [ms] and how many plans."""
        before = len(self.plans)
        while len(self.plans) == before:
            self.reset()
            self._wait(self._plan.call_async(Trigger.Request()).done)
            self._executor.spin_once(timeout_sec=0.1)
        self.spin(START)
        first, plans, begin = len(self.stamps), len(self.plans), time.monotonic()
        while time.monotonic() < begin + seconds:
            self.act()
            self.spin(self.every)
        periods = np.diff(np.array(self.stamps[first:], dtype=np.int64)).astype(np.float64) * 1e-6
        return periods, len(self.plans) - plans

    def close(self) -> None:
        """End the nodes."""
        self._processes.end()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

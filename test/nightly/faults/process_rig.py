# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plant, tracker and planner of a pendulum as processes that can be killed and restarted."""

from __future__ import annotations

from collections.abc import Callable
import math
import os
import signal
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, seconds_of
from trajectory_msgs.msg import JointTrajectory

Array = NDArray[np.float64]

TORQUE = 0.09  # N m, the strong motor
COMMAND_TIMEOUT = STATE_TIMEOUT = 0.1  # s, the defaults of plant and tracker
PATIENCE = 120.0  # s that anything may take on a busy machine
HELD = 0.5  # s upright, after which the pendulum counts as held
UPRIGHT = 0.2  # rad
LONGEST_LOOK = 5.0  # s before a torque that its command is looked for
_QUEUE = 20_000

MODULES = {
    'plant': 'tdm_sim.pendulum_plant',
    'tracker': 'tdm_planner.nodes.tracker',
    'planner': 'tdm_planner.nodes.planner',
}
NODES = {'plant': 'pendulum_plant', 'tracker': 'tracker', 'planner': 'planner'}
PARAMETERS: dict[str, dict[str, Any]] = {
    'plant': {'mismatch': 0.02, 'noise.theta': 0.0015, 'noise.theta_dot': 0.1},
    'tracker': {'replan.interval': 0.3},
    'planner': {'start.delay': 0.6},
}


class ProcessRig:
    """The three nodes in one namespace; parameters by role go on top of `PARAMETERS`."""

    def __init__(self, ros: Ros, namespace: str, **parameters: dict[str, Any]) -> None:
        self.ros, self.namespace = ros, namespace
        self.parameters = {
            role: {'limits.torque': TORQUE, **PARAMETERS[role], **parameters.get(role, {})}
            for role in MODULES
        }
        self.states = self._hear('joint_states', JointState)
        self.commands = self._hear('joint_command', JointState)
        self.plans = self._hear('trajectory', JointTrajectory, LATCHED)
        self.followed = self._hear('trajectory_in_force', JointTrajectory, LATCHED)
        self._diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, _QUEUE)
        self.processes: dict[str, NodeProcess] = {}
        for role in MODULES:
            self.start(role)
        self.wait(lambda: bool(self.states and self.commands))
        self.wait(lambda: self.says('planner', 'ready'))
        self.wait(lambda: self.says('tracker', 'idle'))

    def _hear(self, topic: str, kind: Any, qos: Any = _QUEUE) -> list[Any]:
        heard: list[Any] = self.ros.subscribe(f'/{self.namespace}/{topic}', kind, qos)
        return heard

    # What is done to it.

    def start(self, role: str) -> NodeProcess:
        """Start a node, or start it again."""
        process = self.ros.start(MODULES[role], self.parameters[role], namespace=self.namespace)
        self.processes[role] = process
        return process

    def kill(self, role: str) -> float:
        """Kill a node as the kernel does when memory runs out; returns the instant [s]."""
        process = self.processes[role].process
        os.killpg(process.pid, signal.SIGKILL)
        instant = time.time()
        process.wait(PATIENCE)
        return instant

    def plan(self) -> float:
        """Have a plan made; returns the instant [s] at which its motion starts."""
        known = len(self.plans)
        answer: dict[str, Any] = {'code': 'BUSY'}
        while answer.get('code') == 'BUSY':  # the tracker may have asked as well
            _, answer = self.ros.trigger(f'/{self.namespace}/plan', PATIENCE)
        assert 'plan_id' in answer, answer
        self.wait(lambda: len(self.plans) > known)
        return seconds_of(self.plans[-1].header.stamp)

    def fall(self) -> None:
        """Let the pendulum hang at rest, as if somebody had taken it down."""
        self.ros.call(f'/{self.namespace}/reset', Trigger, timeout=PATIENCE)
        self.wait(lambda: abs(math.remainder(self.states[-1].position[0], math.tau)) > UPRIGHT)
        self.wait(lambda: not self.says('tracker', 'holding'))

    def wait(self, condition: Callable[[], Any]) -> None:
        """Serve messages until a condition holds."""
        assert self.ros.spin_until(lambda: bool(condition()), PATIENCE), self.story()

    # What it does.

    def says(self, role: str, *texts: str) -> bool:
        """Whether the newest diagnostic of a node holds all the texts."""
        statuses = self.statuses(role)
        return bool(statuses) and all(text in statuses[-1].message for text in texts)

    def said(self, role: str, text: str) -> bool:
        """Whether any diagnostic of a node has held the text."""
        return any(text in status.message for status in self.statuses(role))

    def statuses(self, role: str) -> list[Any]:
        """Return every diagnostic status of a node, oldest first."""
        prefix = f'/{self.namespace}/{NODES[role]}: '
        return [
            s for array in self._diagnostics for s in array.status if s.name.startswith(prefix)
        ]

    def figure(self, role: str, key: str) -> float:
        """Return a figure of a node's newest diagnostic."""
        values = {item.key: item.value for item in self.statuses(role)[-1].values}
        return float(values[key])

    @property
    def now(self) -> float:
        """Instant of the newest state [s]."""
        return seconds_of(self.states[-1].header.stamp)

    def held_since(self, instant: float) -> float:
        """Wait until the pendulum is held, from some time after `instant` on; returns when [s]."""
        since = math.inf
        seen = len(self.states)

        def held() -> bool:
            nonlocal since, seen
            for state in self.states[seen:]:
                at = seconds_of(state.header.stamp)
                upright = abs(math.remainder(state.position[0], math.tau)) < UPRIGHT
                since = min(since, at) if upright and at > instant else math.inf
            seen = len(self.states)
            return self.now - since > HELD and self.says('tracker', 'holding')

        self.wait(held)
        return since

    def story(self) -> str:
        """Tell what happened, for the message of a failed test."""
        told = [s.message for role in MODULES for s in self.statuses(role)[-6:]]
        return '\n'.join(told + [p.output[-3000:] for p in self.processes.values()])

    # What was measured.

    @property
    def newest_start(self) -> int:
        """Instant [ns] at which the motion of the newest plan starts."""
        return nanoseconds_of(self.plans[-1].header.stamp)

    def last_command(self) -> float:
        """Instant of the last command that was not zero [s]."""
        return next(
            seconds_of(c.header.stamp) for c in reversed(self.commands) if c.effort[0] != 0.0
        )

    def longest_torque(self) -> float:
        """
        Longest time [s] for which a torque has acted since the command that asked for it.

        From the effort that the plant says acts, and the newest command that asked for as much.
        """
        given = np.array([seconds_of(c.header.stamp) for c in self.commands])
        asked = np.clip([c.effort[0] for c in self.commands], -TORQUE, TORQUE)
        acting = [s for s in self.states if s.effort[1] != 0.0]
        longest, missed = 0.0, 0
        for state in acting:
            at, torque = seconds_of(state.header.stamp), state.effort[1]
            end = int(np.searchsorted(given, at))
            begin = int(np.searchsorted(given, at - LONGEST_LOOK))
            (same,) = np.nonzero(np.abs(asked[begin:end] - torque) < 1e-9)
            if same.size:
                longest = max(longest, at - float(given[begin + same[-1]]))
            else:
                missed += 1
        # Commands are heard by best effort; one that nobody here has heard is no stale one.
        assert missed <= max(5, 0.02 * len(acting)), f'{missed} of {len(acting)} torques unasked'
        return longest

    def last_torque(self, start: float, end: float = math.inf) -> float:
        """Time [s] from `start` to the end of the last torque that acts before `end`."""
        times = [seconds_of(s.header.stamp) for s in self.states if s.effort[1] != 0.0]
        acting = [t for t in times if start <= t <= end]
        return acting[-1] - start if acting else 0.0

    def lean(self, start: float, end: float = math.inf) -> float:
        """Largest angle from upright between two instants [rad]."""
        angles = [
            abs(math.remainder(s.position[0], math.tau))
            for s in self.states
            if start <= seconds_of(s.header.stamp) <= end
        ]
        return max(angles)

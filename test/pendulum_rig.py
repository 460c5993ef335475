# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A pendulum's plant, tracker and planner as real processes that can be killed, misled and measured.

`PendulumRig` starts them in a namespace of its own. With `relayed`, tracker and planner see the
states only as faulty_relay.py passes them on; with `lockstep`, all live in the simulated time of
lockstep_clock.py, which waits for the slowest of them: a busy machine makes a mission longer, and
changes nothing else. What is waited for is waited for long; what is returned are stamps and their
differences. `note` keeps what was measured for the tables of docs/reliability.md.
"""

from __future__ import annotations

from collections.abc import Callable
import json
import math
import os
from pathlib import Path
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of, seconds_of
from trajectory_msgs.msg import JointTrajectory

SECOND = 1_000_000_000  # ns
TORQUE = 0.09  # N m, the strong motor
COMMAND_TIMEOUT = STATE_TIMEOUT = 0.1  # s, the defaults of plant and tracker
PATIENCE = 120.0  # s that anything may take on a busy machine
HELD = 0.5  # s upright, after which the pendulum counts as held
UPRIGHT = 0.2  # rad from upright within which the pendulum is held
SHORTEST_SWING = 0.3  # s, less than any swing-up takes
LONGEST_LOOK = 5.0  # s before a torque that its command is looked for
FIGURES = 'TDM_FAULT_FIGURES'  # the file where `python -m tools.measure_faults` collects
_QUEUE = 20_000

MODULES = {
    'plant': 'tdm_sim.pendulum_plant',
    'relay': 'faulty_relay',
    'tracker': 'tdm_planner.nodes.tracker',
    'planner': 'tdm_planner.nodes.planner',
    'clock': 'lockstep_clock',
}
# The plant is 2 % other than planner and tracker believe, and its sensors are noisy.
PARAMETERS: dict[str, dict[str, Any]] = {
    'plant': {'mismatch': 0.02, 'noise.theta': 0.0015, 'noise.psi': 0.0015,
              'noise.theta_dot': 0.1, 'noise.psi_dot': 0.1},
    'relay': {},
    'tracker': {'replan.on_deviation': True, 'replan.interval': 0.3},
    'planner': {'start.delay': 0.6},
    'clock': {'followers': ['joint_states', 'joint_command', 'passed']},
}  # fmt: skip


def note(scenario: str, **figures: float) -> None:
    """Print what was measured, times in s, and append it as a line of JSON to `FIGURES`."""
    print(f'{scenario}: ' + ', '.join(f'{k} {v:.3f}' for k, v in figures.items()))
    path = os.environ.get(FIGURES)
    if path:
        with Path(path).open('a', encoding='utf-8') as file:
            file.write(json.dumps({'scenario': scenario, **figures}) + '\n')


class PendulumRig:
    """Processes by role, and what the test hears of them; parameters go on top of `PARAMETERS`."""

    def __init__(
        self,
        ros: Ros,
        namespace: str,
        *,
        relayed: bool = False,
        lockstep: bool = False,
        environment: dict[str, str] | None = None,
        **parameters: dict[str, Any],
    ) -> None:
        self.ros, self.namespace = ros, namespace
        self._relayed, self._lockstep = relayed, lockstep
        folder = Path(__file__).parent
        path = f'{folder}:{folder / "nightly" / "faults"}:{ros.environment["PYTHONPATH"]}'
        self._environment = {**(environment or {}), 'PYTHONPATH': path}
        self._parameters = parameters
        self.states = self._hear('joint_states', JointState)
        self.commands = self._hear('joint_command', JointState)
        self.plans = self._hear('trajectory', JointTrajectory, LATCHED)
        self.followed = self._hear('trajectory_in_force', JointTrajectory, LATCHED)
        self._diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, _QUEUE)
        self.processes: dict[str, NodeProcess] = {}
        left_out = [*([] if relayed else ['relay']), *([] if lockstep else ['clock'])]
        for role in MODULES:
            if role not in left_out:
                self.start(role)
        if relayed:
            self._faults = self._tell('fault')
            self._faults_taken = self._hear('fault_taken', String, LATCHED)
            self.mend()
        if lockstep:
            self._orders = self._tell('clock_order')
            self._orders_taken = self._hear('clock_order_taken', String, LATCHED)
        self.wait(lambda: self.states and self.commands)
        self.wait(lambda: self.says('planner', 'ready'))
        self.wait(lambda: self.says('tracker', 'idle'))

    def _hear(self, topic: str, kind: Any, qos: Any = _QUEUE) -> list[Any]:
        heard: list[Any] = self.ros.subscribe(f'/{self.namespace}/{topic}', kind, qos)
        return heard

    def _tell(self, topic: str) -> Any:
        return self.ros.node.create_publisher(String, f'/{self.namespace}/{topic}', LATCHED)

    # What is done to it.

    def parameters(self, role: str) -> dict[str, Any]:
        own = {} if role in ('relay', 'clock') else {'limits.torque': TORQUE}
        time = {'use_sim_time': self._lockstep and role != 'clock'}
        return {**own, **time, **PARAMETERS[role], **self._parameters.get(role, {})}

    def start(self, role: str) -> NodeProcess:
        """Start a node, or start it again."""
        relayed = self._relayed and role in ('tracker', 'planner')
        self.processes[role] = self.ros.start(
            MODULES[role],
            self.parameters(role),
            namespace=self.namespace,
            arguments=['-r', 'joint_states:=relayed/joint_states'] if relayed else None,
            environment=self._environment,
        )
        return self.processes[role]

    def kill(self, role: str) -> float:
        """Kill a node as the kernel does when memory runs out; the instant of the last state."""
        process = self.processes[role].process
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE)
        self.ros.spin_for(0.0)
        return self.now

    def fault(self, kind: str, amount: float = 0.0, at: float = 0.0, seconds: float = 1e9) -> None:
        """Have the relay spoil the states from an instant [s] on: see `faulty_relay.Fault`."""
        when = {'start': round(at * SECOND), 'end': round((at + seconds) * SECOND)}
        text = json.dumps({'kind': kind, 'amount': amount, **when})
        self._faults.publish(String(data=text))
        self.wait(lambda: self._faults_taken and self._faults_taken[-1].data == text)

    def mend(self) -> None:
        """Let the states pass unspoiled."""
        self.fault('none')

    def clock(self, **order: Any) -> None:
        """Do something to the simulated clock: see `lockstep_clock.Order`."""
        known = len(self._orders_taken)
        self._orders.publish(String(data=json.dumps(order)))
        self.wait(lambda: len(self._orders_taken) > known)

    def plan(self) -> tuple[float, float]:
        """Have a plan made; return the instants [s] at which its motion starts and ends."""
        known = len(self.plans)
        answers: list[dict[str, Any]] = []

        def planned() -> bool:
            if self._lockstep:  # planning takes no simulated time, however busy the machine is
                self.clock(paused=True)
            answers.append(self.ros.trigger(f'/{self.namespace}/plan', PATIENCE)[1])
            if self._lockstep:
                self.clock()
            return 'duration' in answers[-1]

        # It may be busy with a request of the tracker's own, or have no fresh state yet.
        assert self.ros.spin_until(planned, PATIENCE), answers[-1]
        self.wait(lambda: len(self.plans) > known)
        start = seconds_of(self.plans[-1].header.stamp)
        return start, start + float(answers[-1]['duration'])

    def fall(self) -> None:
        """Let the pendulum hang at rest, as if somebody had taken it down."""
        self.ros.call(f'/{self.namespace}/reset', Trigger, timeout=PATIENCE)
        self.wait(lambda: abs(self.angle) > UPRIGHT and not self.says('tracker', 'holding'))

    def begin(self) -> tuple[float, float]:
        """Let a swing-up from hanging begin; return the instants of `plan`."""
        if self._relayed:
            self.mend()
        self.ros.call(f'/{self.namespace}/reset', Trigger, timeout=PATIENCE)
        resting = ('idle', 'stopped', 'recovering')
        self.wait(lambda: any(self.says('tracker', word) for word in resting))
        del self.states[:-1], self.commands[:-1]
        for _ in range(5):  # a plan made before it hung leads elsewhere
            start, end = self.plan()
            if end - start > SHORTEST_SWING:
                return start, end
        raise AssertionError(self.story())

    def swing_up(self) -> float:
        """Swing up and hold; return the instant [s] of the newest state then."""
        for _ in range(3):  # a plan may be refused: a clock that was set misleads the planner
            _, end = self.begin()
            self.wait(lambda end=end: self.now > end + 0.3)
            if self.ros.spin_until(lambda: self.is_upright, 5.0):
                return self.now
        raise AssertionError(self.story())

    def wait(self, condition: Callable[[], Any]) -> None:
        """Serve messages until a condition holds."""
        assert self.ros.spin_until(lambda: bool(condition()), PATIENCE), self.story()

    def wait_until(self, instant: float) -> None:
        """Serve messages until the plant's clock has passed an instant [s]."""
        self.wait(lambda: self.now > instant)

    # What it does.

    @property
    def now(self) -> float:
        """Instant of the plant's newest state [s]."""
        return seconds_of(self.states[-1].header.stamp)

    @property
    def angle(self) -> float:
        """Angle from upright of the plant's newest state [rad]."""
        return math.remainder(self.states[-1].position[0], math.tau)

    @property
    def is_upright(self) -> bool:
        """Whether the pendulum stands, and the tracker says that it holds it."""
        return abs(self.angle) < UPRIGHT and self.says('tracker', 'holding')

    def statuses(self, role: str) -> list[Any]:
        """Return every diagnostic status of a node so far, oldest first."""
        name = 'pendulum_plant' if role == 'plant' else role
        prefix = f'/{self.namespace}/{name}: '
        return [
            s for array in self._diagnostics for s in array.status if s.name.startswith(prefix)
        ]

    def says(self, role: str, text: str) -> bool:
        """Whether the newest diagnostic of a node holds the text."""
        statuses = self.statuses(role)
        return bool(statuses) and text in statuses[-1].message

    def said(self, role: str, text: str) -> bool:
        """Whether any diagnostic of a node has held the text."""
        return any(text in status.message for status in self.statuses(role))

    def figure(self, role: str, key: str) -> float:
        """Return a figure of a node's newest diagnostic."""
        return float({item.key: item.value for item in self.statuses(role)[-1].values}[key])

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
        told = [s.message for role in self.processes for s in self.statuses(role)[-6:]]
        return '\n'.join(told + [p.output[-3000:] for p in self.processes.values()])

    # What was measured.

    @property
    def newest_start(self) -> int:
        """Instant [ns] at which the motion of the newest plan starts."""
        return nanoseconds_of(self.plans[-1].header.stamp)

    def measured(self, start: float = 0.0, end: float = math.inf) -> NDArray[np.float64]:
        """Instants [s], theta, psi and applied torque (n, 4) of the plant in [start, end]."""
        rows = np.array(
            [[seconds_of(s.header.stamp), *s.position, s.effort[1]] for s in self.states]
        )
        return rows[(rows[:, 0] >= start) & (rows[:, 0] <= end)]

    def last_torque(self, start: float, end: float = math.inf) -> float:
        """Time from `start` to the last torque in [start, end], s; 0 where there is none."""
        rows = self.measured(start, end)
        acting = rows[rows[:, 3] != 0.0]
        return float(acting[-1, 0] - start) if len(acting) else 0.0

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
        rows = self.measured()
        longest, missed = 0.0, 0
        acting = rows[rows[:, 3] != 0.0]
        for at, _, _, torque in acting:
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

    def lean(self, start: float, end: float = math.inf) -> float:
        """Largest angle from upright in [start, end], rad."""
        theta = self.measured(start, end)[:, 1]
        return float(np.abs((theta + math.pi) % math.tau - math.pi).max())

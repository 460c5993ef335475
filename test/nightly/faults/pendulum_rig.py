# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A pendulum, planner and tracker as processes over DDS, a relay in the stream of its states."""

from __future__ import annotations

from dataclasses import asdict
import json
import math
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from faulty_relay import Fault, SECOND
import numpy as np
from numpy.typing import NDArray
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from trajectory_msgs.msg import JointTrajectory

Array = NDArray[np.float64]

TORQUE = 0.09  # N m, the strong motor
STATE_TIMEOUT = COMMAND_TIMEOUT = 0.1  # s, the defaults of tracker and plant
NOISE = {'theta': 0.0015, 'psi': 0.0015, 'theta_dot': 0.1, 'psi_dot': 0.1}
SHORTEST_SWING = 0.3  # s, less than any swing-up takes
UPRIGHT = 0.2  # rad from upright within which the pendulum is held
PATIENCE = 90.0  # s that anything may take on a busy machine


class PendulumRig:
    """
    Plant, relay, tracker and planner in a namespace, and what the test hears of them.

    The plant is 2 % other than planner and tracker believe, and its sensors are noisy. Tracker and
    planner see the states only as the relay passes them on. With `lockstep` all live in simulated
    time that waits for the slowest of them.
    """

    def __init__(
        self,
        ros: Ros,
        namespace: str = 'rig',
        lockstep: bool = True,
        environment: dict[str, str] | None = None,
        **everywhere: Any,
    ) -> None:
        self.ros, self.namespace, self._lockstep = ros, namespace, lockstep
        self._environment = {
            **(environment or {}),
            'PYTHONPATH': f'{Path(__file__).parent}:{ros.environment["PYTHONPATH"]}',
        }
        self._everywhere = {'limits.torque': TORQUE, **everywhere}
        self._qos = 2000
        self.states = ros.subscribe(f'/{namespace}/joint_states', JointState, self._qos)
        self.commands = ros.subscribe(f'/{namespace}/joint_command', JointState, self._qos)
        self.plans = ros.subscribe(f'/{namespace}/trajectory', JointTrajectory, LATCHED)
        self._taken = ros.subscribe(f'/{namespace}/fault_taken', String, LATCHED)
        self._diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, self._qos)
        self.plant = self._start(
            'tdm_sim.pendulum_plant',
            {'mismatch': 0.02, **{f'noise.{name}': value for name, value in NOISE.items()}},
        )
        self.relay = self._start('faulty_relay', {})
        self.tracker = self.start_tracker()
        self.planner = self._start('tdm_planner.nodes.planner', {'start.delay': 0.6}, relayed=True)
        self._orders = ros.node.create_publisher(String, f'/{namespace}/clock_order', LATCHED)
        self._orders_taken = ros.subscribe(f'/{namespace}/clock_order_taken', String, LATCHED)
        if lockstep:
            self._start(
                'lockstep_clock', {'followers': ['joint_states', 'joint_command', 'passed']}
            )
        self._faults = ros.node.create_publisher(String, f'/{namespace}/fault', LATCHED)
        self.mend()
        assert ros.spin_until(lambda: bool(self.states and self.commands), PATIENCE), self.story()

    def _start(
        self, module: str, parameters: dict[str, Any], relayed: bool = False
    ) -> NodeProcess:
        simulated = self._lockstep and module != 'lockstep_clock'
        everywhere = self._everywhere if module.startswith('tdm_') else {}
        return self.ros.start(
            module,
            {**everywhere, 'use_sim_time': simulated, **parameters},
            namespace=self.namespace,
            arguments=['-r', 'joint_states:=relayed/joint_states'] if relayed else None,
            environment=self._environment,
        )

    def start_tracker(self) -> NodeProcess:
        parameters = {'replan.on_deviation': True, 'replan.interval': 0.3}
        return self._start('tdm_planner.nodes.tracker', parameters, relayed=True)

    # What it is told.

    def fault(self, kind: str, amount: float = 0.0, **when: int) -> None:
        """Have the relay spoil the states, and wait until it has taken note."""
        text = json.dumps(asdict(Fault(kind, amount, seed=7, **when)))
        self._faults.publish(String(data=text))
        taken = self.ros.spin_until(
            lambda: bool(self._taken) and self._taken[-1].data == text, PATIENCE
        )
        assert taken, self.relay.output

    def clock(self, **order: Any) -> None:
        """Do something to the simulated clock: see `lockstep_clock.Order`."""
        text = json.dumps(order)
        known = len(self._orders_taken)
        self._orders.publish(String(data=text))
        assert self.wait(lambda: len(self._orders_taken) > known), 'the clock does not answer'

    def mend(self) -> None:
        """Let the states pass unspoiled."""
        self.fault('none')

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
        assert self.wait(planned), answers[-1]
        answer = answers[-1]
        assert self.ros.spin_until(lambda: len(self.plans) > known, PATIENCE)
        start = nanoseconds_of(self.plans[-1].header.stamp) / SECOND
        return start, start + float(answer['duration'])

    def hang(self) -> None:
        """Put the pendulum back to where it hangs at rest, with a tracker that has given up."""
        self.mend()
        self.ros.call(f'/{self.namespace}/reset', Trigger)
        resting = ('idle', 'stopped', 'recovering')
        assert self.wait(lambda: any(map(self.says, resting))), self.story()
        del self.states[:-1], self.commands[:-1]

    def begin(self) -> tuple[float, float]:
        """Let a swing-up from hanging begin; return the instants of `plan`."""
        self.hang()
        for _ in range(5):  # a plan made before it hung leads elsewhere
            start, end = self.plan()
            if end - start > SHORTEST_SWING:
                return start, end
        raise AssertionError(self.story())

    def swing_up(self) -> float:
        """Swing up and hold; return the instant [s] of the newest state then."""
        for _ in range(3):  # a plan may be refused: a clock that was set misleads the planner
            _, end = self.begin()
            self.wait(lambda end=end: self.newest[0] > end + 0.3)
            if self.wait(lambda: self.is_upright, 5.0):
                return self.newest[0]
        raise AssertionError(self.story())

    # What it does.

    def wait(self, condition: Any, timeout: float = PATIENCE) -> bool:
        """Serve messages until a condition holds."""
        return self.ros.spin_until(condition, timeout)

    def wait_until(self, instant: float) -> bool:
        """Serve messages until the plant's clock has passed an instant [s]."""
        return self.wait(lambda: self.newest[0] > instant)

    @property
    def newest(self) -> tuple[float, float]:
        """Instant [s] and angle [rad] of the plant's newest state."""
        state = self.states[-1]
        return nanoseconds_of(state.header.stamp) / SECOND, state.position[0]

    @property
    def is_upright(self) -> bool:
        """Whether the pendulum stands, and the tracker says that it holds it."""
        _, theta = self.newest
        return abs(math.remainder(theta, math.tau)) < UPRIGHT and self.says('holding')

    def statuses(self, node: str = 'tracker') -> list[Any]:
        """Return every diagnostic status of a node so far."""
        prefix = f'/{self.namespace}/{node}: '
        arrays = self._diagnostics
        return [s for array in arrays for s in array.status if s.name.startswith(prefix)]

    def says(self, *texts: str, node: str = 'tracker') -> bool:
        """Whether the newest diagnostic of a node holds all the texts."""
        prefix = f'/{self.namespace}/{node}: '
        for array in reversed(self._diagnostics):
            for status in array.status:
                if status.name.startswith(prefix):
                    return all(text in status.message for text in texts)
        return False

    def story(self) -> str:
        """Return what happened, for the message of a failed test."""
        said = [s.message for s in self.statuses()][-12:]
        return '\n'.join([*said, self.tracker.output[-2000:], self.planner.output[-1000:]])

    # What was measured.

    def measured(self, start: float = 0.0, end: float = math.inf) -> Array:
        """Instants [s], theta, psi and applied torque (n, 4) of the plant in [start, end]."""
        rows = np.array(
            [
                [nanoseconds_of(s.header.stamp) / SECOND, *s.position, s.effort[1]]
                for s in self.states
            ]
        )
        return rows[(rows[:, 0] >= start) & (rows[:, 0] <= end)]

    def last_torque(self, start: float, end: float) -> float:
        """Time from `start` to the last torque in [start, end], s; 0 where there is none."""
        rows = self.measured(start, end)
        acting = rows[rows[:, 3] != 0.0]
        return float(acting[-1, 0] - start) if len(acting) else 0.0

    def lean(self, start: float, end: float = math.inf) -> float:
        """Largest angle from upright in [start, end], rad."""
        theta = self.measured(start, end)[:, 1]
        return float(np.abs((theta + math.pi) % math.tau - math.pi).max())

    def recovered_after(self, start: float, timeout: float = PATIENCE) -> float:
        """Wait until the pendulum is held again; time since `start` [s]."""
        since: list[float] = []

        def held() -> bool:
            if not self.is_upright:
                since.clear()
            elif not since:
                since.append(self.newest[0])
            return bool(since) and self.newest[0] - since[0] > 0.5

        assert self.wait(held, timeout), self.story()
        return since[0] - start

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A pendulum's plant, tracker and planner that can be killed, misled and measured.

`PendulumRig` starts them in a namespace of its own, as processes or in the test's own process and
time. What is returned are stamps and their differences; `note` keeps them for docs/reliability.md.
`SCENARIOS` kill one of `held_rig`, once in test/system/test_ended.py, over and over in
test/nightly/faults; time waits for plant and tracker while they live.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
import json
import math
import os
from pathlib import Path
import signal
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from ros_harness import PATIENCE, QUEUE, Ros, Space
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.reading import seconds_of

TORQUE = 0.09  # N m, the strong motor
COMMAND_TIMEOUT = STATE_TIMEOUT = 0.1  # s, the defaults of plant and tracker
STEPPED_PATIENCE = 20.0  # s, where that changes nothing
HELD = 0.5  # s upright, after which the pendulum counts as held
UPRIGHT = 0.2  # rad from upright within which the pendulum is held
LONGEST_LOOK = 5.0  # s before a torque that its command is looked for
FIGURES = 'TDM_FAULT_FIGURES'  # the file to keep figures in

# The plant is 2 % other than planner and tracker believe, and its sensors are noisy.
PARAMETERS: dict[str, dict[str, Any]] = {
    'pendulum_plant': {'mismatch': 0.02, 'noise.theta': 0.0015, 'noise.psi': 0.0015,
                       'noise.theta_dot': 0.1, 'noise.psi_dot': 0.1},
    'tracker': {'replan.on_deviation': True, 'replan.interval': 0.3},
    'planner': {'start.delay': 0.6},
}  # fmt: skip


def note(scenario: str, **figures: float) -> None:
    """Print what was measured, times in s, and append it as a line of JSON to `FIGURES`."""
    print(f'{scenario}: ' + ', '.join(f'{k} {v:.3f}' for k, v in figures.items()))
    path = os.environ.get(FIGURES)
    if path:
        with Path(path).open('a', encoding='utf-8') as file:
            file.write(json.dumps({'scenario': scenario, **figures}) + '\n')


def measured_state(at: Any, theta: float = math.pi, **changes: Any) -> JointState:
    """Return what sensors tell at an instant [ns] or stamp: at rest, unless told otherwise."""
    content = {'position': [theta, 0.0], 'velocity': [0.0, 0.0], **changes}
    state = JointState(**{'name': ['pendulum', 'disk'], **content})
    state.header.stamp = to_stamp(at) if isinstance(at, int) else at
    return state


class PendulumRig(Space):
    """The nodes by name, and what the test hears of them; parameters go on top of `PARAMETERS`."""

    plant_arguments: ClassVar[list[str]] = []

    def __init__(self, ros: Ros, namespace: str, common: Any = None, **parameters: Any) -> None:
        super().__init__(ros, namespace)
        self._common, self._parameters = {'limits.torque': TORQUE, **(common or {})}, parameters
        self._patience = STEPPED_PATIENCE if hasattr(ros, 'step_to') else PATIENCE
        usual, ros.depth = ros.depth, QUEUE
        self.states, self.commands = self.hear('joint_states'), self.hear('joint_command')
        self.plans, self.followed = self.hear('trajectory'), self.hear('active_trajectory')
        self._diagnostics, ros.depth = ros.subscribe('/diagnostics'), usual
        self.processes: dict[str, Any] = {}
        for role in PARAMETERS:
            self.start(role)
        self.wait(lambda: self.states and self.commands)
        self.wait(lambda: self.says('planner', 'ready'))

    def start(self, role: str) -> None:
        given = {**self._common, **PARAMETERS[role], **self._parameters.get(role, {})}
        more = self.plant_arguments if role == 'pendulum_plant' else []
        self.processes[role] = super().start(role, given, more)

    def kill(self, role: str) -> float:
        """Kill a process; return the instant of the last state [s]."""
        process = self.processes[role].process
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE)
        self.ros.spin_for(0.0)
        return self.now

    def plan(self) -> tuple[float, float]:
        """Have a plan made; return the instants [s] at which its motion starts and ends."""
        known = len(self.plans)
        answers: list[dict[str, Any]] = []

        def planned() -> bool:
            answers.append(self.ros.trigger(f'{self.space}/plan')[1])
            return 'duration' in answers[-1]

        # It may be busy with a request of the tracker's own, or have no fresh state yet.
        assert self.ros.spin_until(planned, self._patience), answers[-1]
        self.wait(lambda: len(self.plans) > known)
        start = seconds_of(self.plans[-1].header.stamp)
        return start, start + float(answers[-1]['duration'])

    def fall(self) -> None:
        self.trigger('reset')
        self.wait(lambda: abs(self.angle) > UPRIGHT and not self.says('tracker', 'holding'))

    def wait(self, condition: Callable[[], Any]) -> None:
        assert self.ros.spin_until(lambda: bool(condition()), self._patience), self.story()

    def wait_until(self, instant: float) -> None:
        self.wait(lambda: self.now > instant)

    @property
    def now(self) -> float:
        """Instant of the plant's newest state [s]."""
        return seconds_of(self.states[-1].header.stamp)

    @property
    def angle(self) -> float:
        """Angle from upright of the plant's newest state [rad]."""
        return math.remainder(self.states[-1].position[0], math.tau)

    def statuses(self, role: str) -> Iterator[Any]:  # newest first
        prefix = f'{self.space}/{role}: '
        for array in reversed(self._diagnostics):
            yield from (s for s in reversed(array.status) if s.name.startswith(prefix))

    def says(self, role: str, text: str) -> bool:
        return any(text in status.message for status in islice(self.statuses(role), 1))

    def said(self, role: str, text: str) -> bool:
        return any(text in status.message for status in self.statuses(role))

    def figure(self, role: str, key: str) -> float:
        return float({item.key: item.value for item in next(self.statuses(role)).values}[key])

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
        told = [s.message for role in self.processes for s in islice(self.statuses(role), 6)]
        return '\n'.join(told + [p.output[-3000:] for p in self.processes.values()])

    def measured(self, start: float = 0.0, end: float = math.inf) -> NDArray[np.float64]:
        """Instants [s], theta, psi and applied torque (n, 4) of the plant in [start, end]."""
        told = ((seconds_of(s.header.stamp), *s.position, s.effort[1]) for s in self.states)
        rows = np.array([*told])
        return rows[(rows[:, 0] >= start) & (rows[:, 0] <= end)]

    def last_torque(self, start: float, end: float = math.inf) -> float:
        """Time from `start` to the last torque in [start, end], s; 0 where there is none."""
        rows = self.measured(start, end)
        acting = rows[rows[:, 3] != 0.0]
        return float(acting[-1, 0] - start) if len(acting) else 0.0

    def longest_torque(self) -> float:
        """Longest time [s] for which a torque has acted since the newest command for as much."""
        given = np.array([seconds_of(c.header.stamp) for c in self.commands])
        asked = np.clip([c.effort[0] for c in self.commands], -TORQUE, TORQUE)
        rows = self.measured()
        longest, missed = 0.0, 0
        acting = rows[rows[:, 3] != 0.0]
        for at, _, _, torque in acting:
            end = int(np.searchsorted(given, at, 'right'))  # simulated time stands still
            begin = int(np.searchsorted(given, at - LONGEST_LOOK))
            (same,) = np.nonzero(np.abs(asked[begin:end] - torque) < 1e-9)
            longest = max(longest, at - float(given[begin + same[-1]])) if same.size else longest
            missed += not same.size
        # Commands are heard by best effort; one that nobody here has heard is no stale one.
        assert missed <= max(5, 0.02 * len(acting)), f'{missed} of {len(acting)} torques unasked'
        return longest

    def lean(self, start: float = 0.0, end: float = math.inf) -> float:
        theta = self.measured(start, end)[:, 1]
        return float(np.abs((theta + math.pi) % math.tau - math.pi).max())


def held_rig(ros: Ros) -> PendulumRig:
    """Return a pendulum that is held upright, and planned for anew where it is not."""
    ros.drive_clock('/faults/joint_states', '/faults/joint_command')
    rig = PendulumRig(ros, 'faults', common={'use_sim_time': True}, planner={'replan.rate': 5.0})
    rig.wait(lambda: ros.in_step)
    rig.held_since(rig.plan()[0])
    return rig


def plant_killed(rig: PendulumRig, moment: str = 'holding') -> dict[str, float]:
    """Nothing is commanded without a state."""
    if moment == 'tracking':
        rig.fall()
    rig.wait(lambda: rig.says('tracker', moment))
    newest = rig.kill('pendulum_plant')
    rig.wait(lambda: rig.says('tracker', 'older than state_timeout'))
    rig.wait(lambda: rig.commands[-1].effort[0] == 0.0)

    def last_command() -> float:
        last = next(c for c in reversed(rig.commands) if c.effort[0] != 0.0)
        return seconds_of(last.header.stamp)

    safe, seen = last_command() - newest, len(rig.states)
    rig.start('pendulum_plant')
    rig.wait(lambda: len(rig.states) > seen)
    back = seconds_of(rig.states[seen].header.stamp)
    assert last_command() < back
    return {'safe': safe, 'recovered': rig.held_since(back) - back}


def tracker_killed(rig: PendulumRig) -> dict[str, float]:
    """In mid-swing: the plant's torque goes off by itself."""
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking'))
    killed = rig.kill('tracker')
    rig.wait_until(killed + 1.0)
    rig.wait(lambda: rig.states[-1].effort[1] == 0.0)
    safe = rig.last_torque(killed)
    rig.trigger('reset')  # the disk has turned on, where no plan may lead back from
    restarted = rig.ros.seconds
    rig.start('tracker')
    return {'safe': safe, 'recovered': rig.held_since(restarted) - restarted}


def planner_killed(rig: PendulumRig) -> dict[str, float]:
    """While it plans: all goes on, and the active plan comes back as it was."""
    ros, space = rig.ros, rig.space
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking') or rig.says('tracker', 'waiting'))
    ros.request(f'{space}/plan')
    rig.wait(lambda: rig.says('planner', 'planning'))
    held = rig.held_since(rig.kill('planner'))

    def told() -> list[float]:
        return [rig.figure('tracker', f'trajectories {what}') for what in ('accepted', 'rejected')]

    before, plan = told(), rig.followed[-1]
    rig.plans.clear()
    restarted = ros.seconds
    rig.start('planner')
    rig.wait(lambda: rig.plans)
    back = ros.seconds
    rig.wait(lambda: rig.says('planner', 'plan 1 active') or rig.says('planner', 'publish'))
    late = ros.subscribe(f'{space}/trajectory')
    summaries = ros.subscribe(f'{space}/plan_summary')
    rig.wait(lambda: late and summaries)
    assert late[-1].header.stamp == plan.header.stamp, rig.story()
    for found, wanted in zip(late[-1].points, plan.points, strict=True):
        assert (found.positions, found.effort) == (wanted.positions, wanted.effort)
    assert json.loads(summaries[-1].data)['verification']['ok']
    known = len([*rig.statuses('tracker')])
    rig.wait(lambda: len([*rig.statuses('tracker')]) > known + 1)
    assert told() == before
    assert rig.lean(held + 0.5) < 0.2
    done, answer = ros.trigger(f'{space}/plan')
    assert done or answer['code'] == 'BUSY', answer
    return {'safe': 0.0, 'recovered': back - restarted}


SCENARIOS: dict[str, Callable[[PendulumRig], dict[str, float]]] = {
    'plant killed while holding': plant_killed,
    'plant killed in mid-swing': partial(plant_killed, moment='tracking'),
    'tracker killed in mid-swing': tracker_killed,
    'planner killed while planning': planner_killed,
}

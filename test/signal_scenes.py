# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Processes in every phase of their lives, to be ended by signals: see `SCENES`, `WAYS`, `Subject`.

Some end in one way in test/system/test_ended.py, all in every way in test/nightly/faults.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
import math
import os
from pathlib import Path
import signal
import time
import uuid

from pendulum_rig import measured_state, note
from ros_harness import ENOUGH, MODULES, NodeProcess, PATIENCE, Ros, ros_arguments, Space
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import plan_message, to_stamp
from tdm_planner.plant_kind import PENDULUM
from tdm_planner.problems import PendulumSwingUp

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
TORQUE = {'limits.torque': 0.09}
PLANNING = {**TORQUE, 'solver.deadline': ENOUGH, 'start.source': 'parameters'}
# Signals, and the times between them [s].
WAYS: dict[str, list[tuple[signal.Signals, float]]] = {
    'SIGINT': [(INT, 0.0)],
    'SIGTERM': [(TERM, 0.0)],
    'SIGHUP': [(HUP, 0.0)],
    'double Ctrl-C at once': [(INT, 0.0), (INT, 0.0)],
    'double Ctrl-C': [(INT, 0.02), (INT, 0.0)],
    'Ctrl-C while it ends': [(INT, 0.1), (INT, 0.05), (TERM, 0.0)],
}


def survivors(variable: str, command: str = '') -> list[int]:
    """Return the processes with a variable, `NAME=value`, in their environment and a command."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):
            state = (folder / 'stat').read_text().rpartition(')')[2].split()[0]
            variables = (folder / 'environ').read_bytes().split(b'\0')
            known = command in (folder / 'cmdline').read_text()
            if state != 'Z' and variable.encode() in variables and known:
                found.append(int(folder.name))
    return found


class Subject(Space):
    """A process that will be ended, a node or `tdm` with some arguments, and what it leaves."""

    def __init__(self, ros: Ros, name: str, of: dict | list[str]) -> None:
        super().__init__(ros, f'n{uuid.uuid4().hex}')
        self.arguments = of if isinstance(of, list) else ros_arguments(of, self.space)
        environment = {**ros.environment, 'TDM_TEST_MARK': self.space}
        module = 'tdm_planner.cli' if name == 'tdm' else MODULES[name]
        self.process = NodeProcess(module, self.arguments, environment, ros.folder)

    def wait(self, condition: Callable) -> Subject:

        def holds() -> bool:
            assert self.process.running, self.process.output
            return bool(condition())

        assert self.ros.spin_until(holds), self.process.output
        return self

    def says(self, text: str) -> Subject:
        return self.wait(lambda: text in self.process.output)

    def told(self, topic: str, message: Callable, seen: Callable) -> Subject:
        publisher = self.publisher(topic, JointState)
        return self.wait(lambda: publisher.publish(message()) or seen())

    def asked_for_a_plan(self) -> Subject:
        self.says('ready to plan').ros.request(f'{self.space}/plan')
        return self

    def begun(self) -> bool:
        """Whether the package is being imported: SIGTERM is handled, which Python does not do."""
        status = Path(f'/proc/{self.process.process.pid}/status').read_text()
        return bool(int(status.partition('SigCgt:')[2].split()[0], 16) >> (TERM - 1) & 1)

    def end(self, way: str, codes: tuple[int, ...] = (0,)) -> None:
        """Send the signals; one of the codes, output and survivors must be as they should."""
        began = time.monotonic()
        for number, pause in WAYS[way]:
            with suppress(ProcessLookupError):
                os.killpg(self.process.process.pid, number)
            time.sleep(pause)
        found = self.process.process.wait(PATIENCE)
        note(f'ended by {way}', ended=time.monotonic() - began)
        assert found in codes, self.process.output
        for word in ('Traceback', 'fatal', 'Error', 'terminate', 'core dumped'):
            assert word not in self.process.output, self.process.output
        assert not survivors(f'TDM_TEST_MARK={self.space}')


def recording(ros: Ros) -> list[str]:
    return ['record', '-o', str(ros.folder / uuid.uuid4().hex)]


def starting(ros: Ros, name: str) -> Subject:
    given = {'plant': {'problem': 'pendulum_swing_up'}, 'tdm': recording(ros)}.get(name, {})
    subject = Subject(ros, name, given)
    return subject.wait(subject.begun)


def solving_planner(ros: Ros) -> Subject:
    """Return one that searches until the deadline, with a motor too weak."""
    hopeless = {**PLANNING, 'limits.torque': 2e-3, 'solver.deadline': 60.0}
    subject = Subject(ros, 'planner', hopeless).asked_for_a_plan()
    return subject.wait(lambda: ros.trigger(f'{subject.space}/plan')[1]['code'] == 'BUSY')


def reviewing_planner(ros: Ros) -> Subject:
    """Return one that has published, and publishes again."""
    subject = Subject(ros, 'planner', {**PLANNING, 'start.delay': 0.1, 'replan.rate': 100.0})
    heard = subject.hear('trajectory')
    subject.asked_for_a_plan()
    return subject.told('joint_states', hanging, lambda: len(heard) > 1)


def hanging() -> JointState:
    return measured_state(time.time_ns())


def idle_tracker(ros: Ros) -> Subject:
    subject = Subject(ros, 'tracker', TORQUE)
    heard = subject.hear('joint_command')
    return subject.wait(lambda: heard)


def following_tracker(ros: Ros) -> Subject:
    subject = idle_tracker(ros)
    plans = subject.publisher('trajectory')
    heard = subject.hear('joint_command')
    problem = PendulumSwingUp.from_parameters(TORQUE)
    plan = problem.solve(deadline=30.0).trajectory.with_rates(problem.plant.derivative)
    offered = -math.inf

    def moves() -> bool:
        nonlocal offered
        if time.monotonic() > offered + 5.0:  # a machine that pauses may have lost the one before
            offered = time.monotonic()
            stamp = to_stamp(time.time_ns() + 10**9)
            plans.publish(plan_message(PENDULUM, plan, stamp))
        return any(command.effort[0] for command in heard)

    return subject.told('joint_states', hanging, moves)


def driven_plant(ros: Ros) -> Subject:
    names, subject = ['thruster', 'reaction_wheel'], Subject(ros, 'robot_plant', {})
    command = JointState(name=names, velocity=[0.1, 0.0], effort=[0.1, 0.01])
    heard = subject.hear('joint_states')
    acts = lambda: any(any(state.effort) for state in heard)  # noqa: E731
    return subject.told('joint_command', lambda: command, acts)


def busy_recorder(ros: Ros) -> Subject:
    subject, count = Subject(ros, 'tdm', recording(ros)), iter(range(100))
    subject.told('recorded', hanging, lambda: ros.spin_for(0.01) or next(count) > 50)
    return subject.says('Ctrl-C ends')  # which is said once a message is written


def demo(ros: Ros, phase: str) -> Subject:
    parameters, out = ros.folder / 'strong.yaml', str(ros.folder / uuid.uuid4().hex)
    given = f'limits: {{torque: 0.09}}, solver: {{deadline: {ENOUGH}}}, start: {{delay: 3.0}}'
    parameters.write_text(f'/**: {{ros__parameters: {{{given}}}}}')
    arguments = ['demo', 'pendulum', '-o', out, '--params', str(parameters)]
    return Subject(ros, 'tdm', arguments).says(PHASES[phase])


# Of the demo, with what it says then.
PHASES = {'starting': 'starting ', 'asking': 'asking for a plan', 'executing': 'upright at theta',
          'ending': 'ending the nodes', 'reporting': 'plan.json'}  # fmt: skip
SCENES: dict[str, Callable[[Ros], Subject]] = {
    **{f'starting {name}': partial(starting, name=name) for name in (*MODULES, 'tdm')},
    **{scene.__name__.replace('_', ' '): scene for scene in (
        solving_planner, reviewing_planner, idle_tracker, following_tracker, driven_plant,
        busy_recorder)},
    **{f'demo {phase}': partial(demo, phase=phase) for phase in PHASES},
}  # fmt: skip

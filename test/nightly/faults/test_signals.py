# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
SIGINT, SIGTERM and a double Ctrl-C in every phase: code 0, no traceback, nobody left behind.

One of the three each here, every one and more instants with TDM_FAULTS=all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
import itertools
import math
import os
from pathlib import Path
import signal
import time
from typing import Any
import uuid

from fault_figures import EVERYTHING, note
import pytest
from ros_harness import ENOUGH, NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, pendulum_message, to_stamp
from tdm_planner.problems import PendulumSwingUp
from trajectory_msgs.msg import JointTrajectory

PATIENCE = 120.0  # s that anything may take on a busy machine
MARK = 'TDM_TEST_MARK'
INT, TERM = signal.SIGINT, signal.SIGTERM
STRONG = {'limits.torque': 0.09}
# Signals, and the times between them [s].
WAYS: dict[str, list[tuple[signal.Signals, float]]] = {
    'SIGINT': [(INT, 0.0)],
    'SIGTERM': [(TERM, 0.0)],
    'double Ctrl-C at once': [(INT, 0.0), (INT, 0.0)],
    'double Ctrl-C': [(INT, 0.02), (INT, 0.0)],
    'Ctrl-C while it ends': [(INT, 0.1), (INT, 0.05), (TERM, 0.0)],
}


def cases(scenes: list[Any]) -> list[Any]:
    """Return every scene with every way if all is asked for; else each scene with one of them."""
    if EVERYTHING:
        return [(*scene, way) for scene, way in itertools.product(scenes, WAYS)]
    return [(*scene, way) for scene, way in zip(scenes, itertools.cycle(WAYS))]


def survivors(mark: str) -> list[str]:
    """Command lines of the processes that were started with the mark, or by such."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):
            state = (folder / 'stat').read_text().rpartition(')')[2].split()[0]
            if f'{MARK}={mark}'.encode() in (folder / 'environ').read_bytes() and state != 'Z':
                found.append((folder / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
    return found


class Subject:
    """A process that will be ended, and what it leaves."""

    def __init__(
        self,
        ros: Ros,
        module: str,
        parameters: dict[str, Any] | None = None,
        arguments: list[str] | None = None,
    ) -> None:
        self.ros = ros
        self.mark = uuid.uuid4().hex
        self.namespace = f'n{self.mark}'
        self.process: NodeProcess = (
            ros.start(
                module,
                parameters,
                namespace=self.namespace,
                environment={MARK: self.mark},
            )
            if arguments is None
            else self._command(module, arguments)
        )

    def _command(self, module: str, arguments: list[str]) -> NodeProcess:
        return NodeProcess(
            module, arguments, {**self.ros.environment, MARK: self.mark}, self.ros.folder
        )

    def wait(self, condition: Callable[[], Any]) -> None:
        """Serve messages until a condition holds."""

        def holds() -> bool:
            assert self.process.running, self.process.output
            return bool(condition())

        assert self.ros.spin_until(holds, PATIENCE), self.process.output

    def hears(self, topic: str, kind: Any, qos: Any = 10) -> list[Any]:
        """Subscribe to a topic in the process's namespace."""
        heard: list[Any] = self.ros.subscribe(f'/{self.namespace}/{topic}', kind, qos)
        return heard

    def end(self, way: str, code: int = 0) -> None:
        """Send the signals; code, output and survivors must be as they should."""
        began = time.monotonic()
        for number, pause in WAYS[way]:
            with suppress(ProcessLookupError):
                os.killpg(self.process.process.pid, number)
            time.sleep(pause)
        found = self.process.process.wait(PATIENCE)
        note(f'ended by {way}', ended=time.monotonic() - began)
        assert found == code, self.process.output
        for word in ('Traceback', 'fatal', 'Error', 'terminate', 'core dumped'):
            assert word not in self.process.output, self.process.output
        assert not survivors(self.mark)


def begun(process: NodeProcess) -> bool:
    """Whether the package is being imported: SIGTERM is handled, which Python does not do."""
    lines = Path(f'/proc/{process.process.pid}/status').read_text().splitlines()
    (line,) = (line for line in lines if line.startswith('SigCgt'))
    return bool(int(line.split()[1], 16) >> (TERM - 1) & 1)


# Starting: from the first import on.

DELAYS = [0.05 * k for k in range(40)] if EVERYTHING else [0.1, 0.5]
STARTING: dict[str, tuple[str, dict[str, Any] | None, list[str] | None]] = {
    'planner': ('tdm_planner.nodes.planner', {}, None),
    'tracker': ('tdm_planner.nodes.tracker', {}, None),
    'pendulum_plant': ('tdm_sim.pendulum_plant', {}, None),
    'robot_plant': ('tdm_sim.robot_plant', {}, None),
    'record': ('tdm_planner.cli', None, ['record', '-o']),
}


@pytest.mark.parametrize(('kind', 'way'), cases([(kind,) for kind in STARTING]))
def test_while_it_starts(ros: Ros, kind: str, way: str) -> None:
    module, parameters, arguments = STARTING[kind]
    for delay in DELAYS:
        if arguments:
            arguments = [*arguments[:2], str(ros.folder / uuid.uuid4().hex)]
        subject = Subject(ros, module, parameters, arguments)
        end = time.monotonic() + PATIENCE
        while not begun(subject.process):
            assert time.monotonic() < end
            time.sleep(0.002)
        time.sleep(delay)
        subject.end(way)


# Running.


def idle_planner(ros: Ros) -> Subject:
    subject = Subject(ros, 'tdm_planner.nodes.planner', STRONG)
    subject.wait(lambda: 'ready to plan' in subject.process.output)
    return subject


def solving_planner(ros: Ros) -> Subject:
    # So weak that it searches until the deadline.
    hopeless = {'limits.torque': 2e-3, 'solver.deadline': 60.0, 'start.source': 'parameters'}
    subject = Subject(ros, 'tdm_planner.nodes.planner', hopeless)
    subject.wait(lambda: 'ready to plan' in subject.process.output)
    pending = ros.request(f'/{subject.namespace}/plan', Trigger)
    ros.spin_for(0.3)
    assert not pending.done()
    return subject


def publishing_planner(ros: Ros) -> Subject:
    subject = Subject(ros, 'tdm_planner.nodes.planner', {**STRONG, 'start.source': 'parameters'})
    heard = subject.hears('trajectory', JointTrajectory, LATCHED)
    ros.request(f'/{subject.namespace}/plan', Trigger)
    subject.wait(lambda: bool(heard))
    return subject


def reviewing_planner(ros: Ros) -> Subject:
    subject = Subject(
        ros,
        'tdm_planner.nodes.planner',
        {**STRONG, 'start.delay': 0.1, 'replan.rate': 100.0, 'start.source': 'parameters'},
    )
    states = ros.publisher(f'/{subject.namespace}/joint_states', JointState)
    heard = subject.hears('trajectory', JointTrajectory, LATCHED)
    ros.request(f'/{subject.namespace}/plan', Trigger)

    def replanned() -> bool:
        states.publish(hanging())
        return len(heard) > 1

    subject.wait(replanned)
    return subject


def hanging() -> JointState:
    state = JointState(
        name=['pendulum', 'disk'], position=[math.pi, 0.0], velocity=[0.0, 0.0], effort=[0.0, 0.0]
    )
    state.header.stamp = to_stamp(time.time_ns())
    return state


def idle_tracker(ros: Ros) -> Subject:
    subject = Subject(ros, 'tdm_planner.nodes.tracker', STRONG)
    heard = subject.hears('joint_command', JointState)
    subject.wait(lambda: bool(heard))
    return subject


def following_tracker(ros: Ros) -> Subject:
    subject = idle_tracker(ros)
    states = ros.publisher(f'/{subject.namespace}/joint_states', JointState)
    plans = ros.publisher(f'/{subject.namespace}/trajectory', JointTrajectory, LATCHED)
    heard = subject.hears('joint_command', JointState)
    problem = PendulumSwingUp.from_parameters(STRONG)
    plan = problem.solve(deadline=30.0).trajectory.with_rates(problem.plant.derivative)
    plans.publish(pendulum_message(plan, to_stamp(time.time_ns() + 10**9)))

    def follows() -> bool:
        states.publish(hanging())
        return any(command.effort[0] != 0.0 for command in heard)

    subject.wait(follows)
    return subject


def idle_plant(ros: Ros) -> Subject:
    subject = Subject(ros, 'tdm_sim.pendulum_plant')
    heard = subject.hears('joint_states', JointState)
    subject.wait(lambda: bool(heard))
    return subject


def driven_plant(ros: Ros) -> Subject:
    subject = idle_plant(ros)
    return driven(subject, JointState(name=['disk'], effort=[0.01]))


def idle_robot(ros: Ros) -> Subject:
    subject = Subject(ros, 'tdm_sim.robot_plant')
    heard = subject.hears('joint_states', JointState)
    subject.wait(lambda: bool(heard))
    return subject


def driven_robot(ros: Ros) -> Subject:
    names = ['thruster', 'reaction_wheel']
    command = JointState(name=names, velocity=[0.1, 0.0], effort=[0.1, 0.01])
    return driven(idle_robot(ros), command)


def driven(subject: Subject, command: JointState) -> Subject:
    ros = subject.ros
    commands = ros.publisher(f'/{subject.namespace}/joint_command', JointState)
    heard = subject.hears('joint_states', JointState)

    def acts() -> bool:
        commands.publish(command)
        return any(any(state.effort) for state in heard)

    subject.wait(acts)
    return subject


def recorder(ros: Ros) -> Subject:
    bag = ros.folder / uuid.uuid4().hex
    subject = Subject(ros, 'tdm_planner.cli', None, ['record', '-o', str(bag)])
    subject.wait(lambda: 'Ctrl-C ends' in subject.process.output)
    return subject


def busy_recorder(ros: Ros) -> Subject:
    subject = recorder(ros)
    publisher = ros.publisher('/recorded', JointState)
    end = time.monotonic() + 1.0

    def published() -> bool:
        publisher.publish(hanging())
        return time.monotonic() > end

    subject.wait(published)
    return subject


RUNNING = {
    scene.__name__: scene
    for scene in (
        idle_planner,
        solving_planner,
        publishing_planner,
        reviewing_planner,
        idle_tracker,
        following_tracker,
        idle_plant,
        driven_plant,
        idle_robot,
        driven_robot,
        recorder,
        busy_recorder,
    )
}


@pytest.mark.parametrize(('scene', 'way'), cases([(name,) for name in RUNNING]))
def test_while_it_runs(ros: Ros, scene: str, way: str) -> None:
    RUNNING[scene](ros).end(way)


def test_a_recording_that_is_ended_can_be_read(ros: Ros) -> None:
    highlevel = pytest.importorskip('rosbags.highlevel')
    subject = busy_recorder(ros)
    arguments = subject.process.process.args
    assert isinstance(arguments, list)
    bag = Path(arguments[-1])
    subject.end('Ctrl-C while it ends')
    with highlevel.AnyReader([bag]) as reader:
        assert reader.message_count > 10


# The demo, with the nodes that it has started. It has not reached its goal: its code says so.

PHASES = {
    'starting': 'starting ',
    'asking': 'asking for a plan',
    'executing': 'upright at theta',
    'ending': 'ending the nodes',
    'reporting': 'plan.json',
}


@pytest.fixture
def demo(ros: Ros, tmp_path: Path) -> Iterator[Subject]:
    parameters = tmp_path / 'strong.yaml'
    parameters.write_text(
        '/**:\n  ros__parameters:\n    limits: {torque: 0.09}\n'
        f'    solver: {{deadline: {ENOUGH}}}\n'
    )
    subject = Subject(
        ros,
        'tdm_planner.cli',
        None,
        ['demo', 'pendulum', '-o', str(tmp_path / 'out'), '--params', str(parameters)],
    )
    yield subject
    if subject.process.running:
        os.killpg(subject.process.process.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ('phase', 'way'),
    cases([(phase,) for phase in (PHASES if EVERYTHING else ('starting', 'executing'))]),
)
def test_the_demo(demo: Subject, phase: str, way: str) -> None:
    demo.wait(lambda: PHASES[phase] in demo.process.output)
    demo.ros.spin_for(0.2)
    demo.end(way, code=128 + WAYS[way][0][0])

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes as real processes over real DDS, and a node in the test that talks to them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
import ctypes
import fcntl
import functools
import itertools
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, ClassVar

from tdm_planner.starting import NODES as MODULES

ENOUGH = 40.0  # s for a plan, so that the deadline never decides on a busy machine
UNHURRIED = ['--set', f'solver.deadline={ENOUGH}']  # for `tdm plan`
PATIENCE = 120.0  # s that anything may take on a busy machine
QUEUE = 20_000  # messages that may wait where every one counts
CLOCK_STEP = 0.005  # s, the period of tracker and plant
STALL = 8.0  # s of real time for which a busy computer may hold up one of them
MATCHING = 0.4  # s; longer than between two announcements, see DISCOVERY_PROFILE
SOURCE = Path(__file__).resolve().parents[1]
DISCOVERY_PROFILE = Path(__file__).with_name('quick_discovery.xml')


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Yield a ROS_DOMAIN_ID in 1..101 that no other test process uses meanwhile."""
    for domain in random.sample(range(1, 102), 101):
        name = f'tdm_planner_ros_domain_{domain}.lock'
        with Path(tempfile.gettempdir(), name).open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError('every ROS domain is in use')


def ros_environment(domain: int, folder: Path) -> dict[str, str]:
    """
    Variables that keep ROS traffic on this machine, quick, and the logs in `folder`.

    Messages go by UDP: shared memory of a process that was killed may swallow those for its
    successor.
    """
    places = filter(None, (str(SOURCE), os.environ.get('PYTHONPATH')))
    return {
        'ROS_DOMAIN_ID': str(domain),
        'ROS_LOG_DIR': str(folder / 'log'),
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(DISCOVERY_PROFILE),
        'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4',
        'PYTHONPATH': os.pathsep.join(places),
    }


def ros_arguments(parameters: Mapping[str, Any], namespace: str = '') -> list[str]:
    arguments = ['--ros-args', *(['-r', f'__ns:=/{namespace.strip("/")}'] if namespace else [])]
    for name, value in parameters.items():
        text = value if isinstance(value, str) else json.dumps(value)
        arguments += ['-p', f'{name}:={text}']
    return arguments


@functools.cache
def topics() -> dict[str, tuple[Any, Any]]:
    """Return type and quality of service of the package's topics, by the last of their names."""
    from action_msgs.msg import GoalStatusArray
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry, Path
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
    from tdm_planner.nodes.messages import LATCHED
    from trajectory_msgs.msg import JointTrajectory
    from visualization_msgs.msg import MarkerArray

    latched = {'trajectory': JointTrajectory, 'active_trajectory': JointTrajectory, 'path': Path,
               'plan_summary': String, 'robot_description': String, 'markers': MarkerArray,
               'tracker_status': GoalStatusArray}  # fmt: skip
    others = {'joint_states': JointState, 'joint_command': JointState, 'odom': Odometry,
              'tracking_error': JointState, 'plant_markers': MarkerArray,
              'diagnostics': DiagnosticArray}  # fmt: skip
    found = {name: (kind, LATCHED) for name, kind in latched.items()}
    return found | {name: (kind, None) for name, kind in others.items()}


def topic_of(name: str, kind: Any, qos: Any, depth: int = 10) -> tuple[Any, str, Any]:
    """Return type, name and quality of service: what is not given is as `topics` has it."""
    known, usual = topics().get(name.rpartition('/')[2], (None, None))
    return kind or known, name, qos or usual or depth


def parameters(values: Mapping[str, Any]) -> list[Any]:
    """Return messages for values by name, ``__`` for the dot."""
    from rclpy.parameter import Parameter

    named = {name.replace('__', '.'): value for name, value in values.items()}
    return [Parameter(name, value=value).to_parameter_msg() for name, value in named.items()]


def _end_with_the_tests() -> None:
    """Have the kernel kill this process when the tests die; hear signals that they ignore."""
    for number in (signal.SIGINT, signal.SIGHUP):  # in the background, under nohup
        signal.signal(number, signal.SIG_DFL)
    set_parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


class Started:
    """What a test has started; `end` returns its exit code, `output` what it has printed."""

    def end_cleanly(self) -> None:
        """End it; the exit code must be 0 and nothing may look like a crash."""
        code = self.end()
        assert code == 0, f'ended with {code}:\n{self.output}'
        assert 'Traceback' not in self.output, self.output


class NodeProcess(Started):
    """A program, or a module of Python that may be a node's, in a process group of its own."""

    def __init__(self, program: str, arguments: list[str], environment: Any, folder: Path) -> None:
        self.output_file = Path(tempfile.mkstemp(dir=folder, suffix='.txt')[1])
        self.command = [program, *arguments]
        start = [] if os.path.isabs(program) else [sys.executable, '-m']
        own = {'start_new_session': True, 'preexec_fn': _end_with_the_tests}
        own |= {'env': {**os.environ, **environment}, 'stderr': subprocess.STDOUT}
        with self.output_file.open('w') as output:
            self.process = subprocess.Popen(start + self.command, stdout=output, **own)

    @property
    def output(self) -> str:
        return self.output_file.read_text()

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def end(self, number: int = signal.SIGINT) -> int:
        if self.running:
            os.killpg(self.process.pid, number)
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            told = f'{self.command} did not end within {PATIENCE} s of {number}:\n{self.output}'
            raise AssertionError(told) from None


class Ros:
    """
    A ROS domain of the test's own: starts nodes in it, and talks to them with `node`.

    Nothing is served in the background: messages arrive during `spin_until` and `call`, and so
    does the time of nodes with `use_sim_time` once `drive_clock` was called.
    """

    common: ClassVar[dict[str, Any]] = {}  # parameters of every node
    depth = 10  # messages that may wait: those who see real processes must not fall behind

    def __init__(self, domain: int, folder: Path, environment: Mapping[str, str]) -> None:
        import rclpy

        self.domain = domain
        self.folder, self.environment = folder, dict(environment)
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node('test', context=self._context)
        self._executor = self.executor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._processes: list[NodeProcess] = []
        self._clock: Any = None

    def executor(self, **options: Any) -> Any:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor(**options)

    def start(self, role: str, given: Any = None, namespace: str = '', arguments: Any = ()) -> Any:
        """Start a node with parameters; it ends with the fixture, planners have time."""
        given = {**self.common, **(given or {})}
        if role == 'planner' and '--params-file' not in arguments:
            given = {'solver.deadline': ENOUGH, **given}
        return self._begin(role, [*ros_arguments(given, namespace), *arguments])

    def _begin(self, role: str, arguments: list[str]) -> Started:
        return self.run(MODULES[role], arguments)

    def run(self, module: str, arguments: list[str], environment: Any = None) -> NodeProcess:
        """Run a module in the domain, which need not be a node; it ends as those of `start` do."""
        variables = {**self.environment, **(environment or {})}
        process = NodeProcess(module, arguments, variables, self.folder)
        self._processes.append(process)
        return process

    def drive_clock(self, *followers: str) -> None:
        """Publish `/clock`, and wait at each step for the topics of `followers`, if they live."""
        from tdm_sim.clock_source import ClockSource

        self._clock = ClockSource(self.node, CLOCK_STEP, 1.0, followers, STALL)

    @property
    def in_step(self) -> bool:
        """Whether the clock waits for all that it is to wait for: it has heard them lately."""
        return not any(follower.silent for follower in self._clock._followers)

    @property
    def seconds(self) -> float:
        """Present instant of the nodes' clock [s]."""
        return float(self.node.get_clock().now().nanoseconds * 1e-9)

    def spin_until(self, condition: Callable[[], bool], timeout: float = PATIENCE) -> bool:
        """Serve callbacks until `condition` holds; False when `timeout` s have passed."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            if self._clock is not None:
                self._clock.advance()
            self._executor.spin_once(timeout_sec=0.02 if self._clock is None else 0.001)
        return True

    def spin_for(self, seconds: float) -> None:
        """Serve callbacks for a while, to show that something does not happen."""
        self.spin_until(lambda: False, seconds)

    def latched(self, topic: str) -> Any:
        received = self.subscribe(topic)
        assert self.meet(lambda: bool(received)), f'nothing was published on {topic}'
        (message,) = received
        return message

    def subscribe(self, topic: str, kind: Any = None, qos: Any = None) -> list[Any]:
        """Subscribe; the list returned grows with every message received."""
        received: list[Any] = []
        kind, topic, qos = topic_of(topic, kind, qos, self.depth)
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def publisher(self, topic: str, kind: Any = None, qos: Any = None) -> Any:
        """Make a publisher and wait until somebody listens."""
        publisher = self.node.create_publisher(*topic_of(topic, kind, qos))
        heard = self.meet(lambda: publisher.get_subscription_count() > 0)
        assert heard, f'nobody listens to {topic}'
        return publisher

    def meet(self, known: Callable[[], bool]) -> bool:
        """
        Wait until an endpoint elsewhere is known, and a little longer: it may match later.

        On a busy machine this is not enough: what must be heard is sent with `publish_until`.
        """
        met = self.spin_until(known)
        self.spin_for(MATCHING)
        return met

    def publish_until(self, publish: Any, heard: Callable[[], bool], every: float = 0.02) -> bool:
        """Publish every so many s until it was heard; False when nobody hears it."""

        def sent() -> bool:
            publish()
            return self.spin_until(heard, every)

        return self.spin_until(sent, PATIENCE)

    def request(self, service: str, kind: Any = None, request: Any = None) -> Any:
        """Send a request, a Trigger's unless said, without waiting for its answer; a Future."""
        from std_srvs.srv import Trigger

        kind = kind or Trigger
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
            assert self.meet(self._clients[service].service_is_ready), f'no service {service}'
        client = self._clients[service]
        assert self.spin_until(client.service_is_ready), f'no service {service}'
        return client.call_async(request or kind.Request())

    def call(self, service: str, kind: Any = None, request: Any = None) -> Any:
        future = self.request(service, kind, request)
        assert self.spin_until(future.done, PATIENCE), f'{service} did not answer'
        return future.result()

    def trigger(self, service: str) -> tuple[bool, dict[str, Any]]:
        response = self.call(service)
        assert '\n' not in response.message
        return response.success, json.loads(response.message)

    def set_parameters(self, node: str, values: Any = None, **named: Any) -> list[str]:
        """Set parameters (None unsets, see `parameters` for names); a reason each, '' if done."""
        from rcl_interfaces.srv import SetParameters

        request = SetParameters.Request(parameters=parameters({**(values or {}), **named}))
        response = self.call(f'{node}/set_parameters', SetParameters, request)
        assert all(bool(r.reason) != r.successful for r in response.results)
        return [r.reason for r in response.results]

    def set_all(self, service: str, *odd: Any, **named: Any) -> Any:
        """Ask for values all at once, as `plan_with` is asked; return the result."""
        from rcl_interfaces.srv import SetParametersAtomically

        request = SetParametersAtomically.Request(parameters=[*parameters(named), *odd])
        return self.call(service, SetParametersAtomically, request).result

    def change(self, node: str, asked: int | str | dict[str, Any]) -> bool:
        """Ask for a transition of a managed node, by number, name, or as the message has it."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        if not isinstance(asked, dict):
            asked = {'label' if isinstance(asked, str) else 'id': asked}
        request = ChangeState.Request(transition=Transition(**asked))
        return bool(self.call(f'{node}/change_state', ChangeState, request).success)

    def close(self) -> None:
        """End everything; a process still running must end cleanly."""
        import rclpy

        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
        with ExitStack() as every:  # goes on where one fails
            for process in self._processes:
                if process.running:
                    every.callback(process.end_cleanly)


class Space:
    """A namespace of the test's own, whose name may be given: nodes, topics and services in it."""

    numbers = itertools.count()

    def __init__(self, ros: Any, name: str = '') -> None:
        self.ros, self.space = ros, '/' + (name or f'space{next(self.numbers)}')

    def start(self, role: str, given: Any = None, arguments: Sequence[str] = ()) -> Any:
        return self.ros.start(role, given, self.space, arguments)

    def hear(self, topic: str, *kind: Any) -> list[Any]:
        return self.ros.subscribe(f'{self.space}/{topic}', *kind)

    def publisher(self, topic: str, *kind: Any) -> Any:
        return self.ros.publisher(f'{self.space}/{topic}', *kind)

    def latched(self, topic: str) -> Any:
        return self.ros.latched(f'{self.space}/{topic}')

    def set(self, role: str, values: Any = None, **named: Any) -> None:  # noqa: A003
        assert not any(self.ros.set_parameters(f'{self.space}/{role}', values, **named))

    def trigger(self, service: str) -> str:
        response = self.ros.call(f'{self.space}/{service}')
        assert response.success, response.message
        self.ros.spin_for(0.0)
        return str(response.message)

    def plan(self) -> dict[str, Any]:
        return json.loads(self.trigger('plan'))

    def refusal(self) -> tuple[str, str]:
        """Return code and reason of a request that comes to nothing."""
        done, answer = self.ros.trigger(f'{self.space}/plan')
        assert (done, list(answer)) == (False, ['code', 'reason'])
        return answer['code'], answer['reason']

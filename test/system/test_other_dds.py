# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The planner as seen by Eclipse Cyclone DDS, without any of ROS.

Of ROS come the definitions of messages only, which `dds_type` turns into those of DDS. A message
`pkg/msg/Name` is the DDS type `pkg::msg::dds_::Name_`; a topic `/a/b` is `rt/a/b`, a service
`/a/b` a pair of topics, `rq/a/bRequest` and `rr/a/bReply`. An outsider sees every reply of a
service: Cyclone's binding does not show the parameter by which clients of ROS know their own.
"""

from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
import json
import math
from pathlib import Path
import time

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
import pytest
from ros_harness import ENOUGH, PATIENCE
from tdm_planner.nodes.reading import nanoseconds_of

STRONG = {'limits.torque': 0.09, 'torque_reserve': 0.0, 'solver.deadline': ENOUGH}
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
# As ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST has it: this machine only, found without multicast.
CONFIGURATION = Path(__file__).with_name('cyclonedds.xml').as_uri()
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
VOLATILE = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
PRIMITIVES = {
    'double': types.float64, 'int32': types.int32, 'uint32': types.uint32, 'octet': types.byte,
    'string': str,
}  # fmt: skip


@cache
def dds_type(name: str):
    """Return the type of DDS for `pkg/msg/Name` or `pkg/srv/Name_Request`."""
    package, folder, kind = name.split('/')
    of = getattr(import_module(f'{package}.{folder}'), kind.partition('_')[0])
    if '_' in kind:
        of = getattr(of, kind.partition('_')[2])
    fields = {key: _member(text) for key, text in of.get_fields_and_field_types().items()}
    fields = fields or {'structure_needs_at_least_one_member': types.uint8}
    return make_idl_struct(f'{kind}_', f'{package}::{folder}::dds_::{kind}_', fields)


def _member(text: str):
    if text.startswith('sequence<'):
        return types.sequence[_member(text.removeprefix('sequence<').removesuffix('>'))]
    return dds_type(text.replace('/', '/msg/')) if '/' in text else PRIMITIVES.get(text, bool)


def wait_until(condition: Callable, timeout: float = PATIENCE):
    """Wait for something that another process does, and return it."""
    end = time.monotonic() + timeout
    while not (found := condition()):
        assert time.monotonic() < end, f'not within {timeout} s'
        time.sleep(0.01)
    return found


def one(reader: DataReader, timeout: float = PATIENCE):
    return wait_until(partial(reader.take, N=1), timeout)[0]


class Outsider:
    """Reads and writes topics in a ROS domain."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, CONFIGURATION)
        self._participant = DomainParticipant(domain)

    def reader(self, topic: str, kind: str, qos: Qos = VOLATILE) -> DataReader:
        made = Topic(self._participant, topic, dds_type(kind))
        reader = DataReader(self._participant, made, qos=qos)
        wait_until(reader.get_matched_publications)
        return reader

    def writer(self, topic: str, kind: str) -> DataWriter:
        made = Topic(self._participant, topic, dds_type(kind))
        writer = DataWriter(self._participant, made, qos=VOLATILE)
        wait_until(writer.get_matched_subscriptions)
        return writer


class Client:
    """One service, asked by writing and answered by reading."""

    def __init__(self, outsider: Outsider, service: str) -> None:
        self._requests = outsider.writer(f'rq{service}Request', 'std_srvs/srv/Trigger_Request')
        self._replies = outsider.reader(f'rr{service}Reply', 'std_srvs/srv/Trigger_Response')
        # The server may know of us a little later than we know of it; its replies are lost until
        # then. Those that are merely late are waited for.
        asked = answered = 0
        while not answered:
            self.ask()
            asked += 1
            assert asked < 30, 'the service does not answer'
            with suppress(AssertionError):
                while answered < asked:
                    self.reply(8.0)
                    answered += 1

    def ask(self) -> None:
        self._requests.write(dds_type('std_srvs/srv/Trigger_Request')(0))

    def reply(self, timeout: float = PATIENCE) -> tuple[bool, dict]:
        reply = one(self._replies, timeout)
        return bool(reply.success), json.loads(reply.message)

    def call(self) -> tuple[bool, dict]:
        self.ask()
        return self.reply()


def test_an_outsider_asks_for_plans_and_reads_them(ros):
    ros.start('planner', STRONG, 'pendulum')
    outsider = Outsider(ros.domain)
    client = Client(outsider, '/pendulum/plan')
    success, answer = client.call()
    assert not success
    assert answer['code'] == 'NO_STATE'
    assert ros.set_parameters('/pendulum/planner', start__source='parameters') == ['']
    before = time.time_ns()
    success, answer = client.call()
    assert success, answer
    # One who comes late reads it, too.
    plan = one(outsider.reader('rt/pendulum/trajectory', TRAJECTORY, LATCHED))
    assert plan.joint_names == ['pendulum', 'disk']
    assert before < nanoseconds_of(plan.header.stamp)
    times = [nanoseconds_of(point.time_from_start) for point in plan.points]
    assert times == sorted(set(times))
    assert times[-1] / 1e9 == pytest.approx(answer['duration'], abs=1e-6)
    assert plan.points[0].positions == [math.pi, 0.0]
    assert math.remainder(plan.points[-1].positions[0], math.tau) == pytest.approx(0.0, abs=1e-4)
    assert all(abs(point.effort[1]) <= 0.09 + 1e-9 for point in plan.points)
    reader = outsider.reader('rt/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
    _, answer = client.call()
    wait_until(lambda: f"'plan id', value='{answer['plan_id']}'" in repr(reader.take(N=10)))
    # Both ask at once: each gets one answer, and a client of ROS its own.
    future = ros.request('/pendulum/plan')
    client.ask()
    assert ros.spin_until(future.done)
    assert any(fine for fine, _ in (client.reply(), client.reply()))
    done, answer = ros.trigger('/pendulum/plan')
    assert done, answer
    assert client.reply() == (True, answer)

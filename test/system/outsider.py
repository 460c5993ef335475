# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A participant that has nothing of ROS in it: Eclipse Cyclone DDS, by its Python binding.

Of ROS come the definitions of messages only, which `dds_type` turns into those of DDS. A message
`pkg/msg/Name` is the DDS type `pkg::msg::dds_::Name_`; a topic `/a/b` is `rt/a/b`, a service
`/a/b` a pair of topics, `rq/a/bRequest` and `rr/a/bReply`.

What is known of services: the server of rmw_fastrtps takes a request's identity (writer and
sequence number) from the DDS sample, and puts it on its reply as the inline parameter `related
sample identity`, by which clients of ROS find the answer to their question. The request needs
nothing for that, so anybody can ask. The binding shows no inline parameters: an outsider sees
every reply of the service, and knows its own only if nobody else asks meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import functools
from importlib import import_module
import json
import time
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# As ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST has it: this machine only, found without multicast.
CONFIGURATION = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface name="lo"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>31</MaxAutoParticipantIndex>
    <SPDPInterval>300ms</SPDPInterval>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
VOLATILE = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
PRIMITIVES: dict[str, Any] = {
    'double': types.float64, 'int32': types.int32, 'uint32': types.uint32, 'octet': types.byte,
    'string': str,
}  # fmt: skip


@functools.cache
def dds_type(name: str) -> Any:
    """Return the type of DDS for `pkg/msg/Name` or `pkg/srv/Name_Request`."""
    package, folder, kind = name.split('/')
    of = getattr(import_module(f'{package}.{folder}'), kind.partition('_')[0])
    if '_' in kind:
        of = getattr(of, kind.partition('_')[2])
    fields = {key: _member(text) for key, text in of.get_fields_and_field_types().items()}
    fields = fields or {'structure_needs_at_least_one_member': types.uint8}
    return make_idl_struct(f'{kind}_', f'{package}::{folder}::dds_::{kind}_', fields)


def _member(text: str) -> Any:
    if text.startswith('sequence<'):
        return types.sequence[_member(text.removeprefix('sequence<').removesuffix('>'))]
    return dds_type(text.replace('/', '/msg/')) if '/' in text else PRIMITIVES.get(text, bool)


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def wait_until(condition: Callable[[], Any], what: str, timeout: float = 60.0) -> None:
    """Wait for something that another process does."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f'{what}: not within {timeout} s'
        time.sleep(0.01)


def one(reader: DataReader, timeout: float = 60.0) -> Any:
    """Return the next message."""
    taken: list[Any] = []
    wait_until(
        lambda: taken.extend(reader.take(N=1)) or taken,
        f'a message on {reader.topic.name}',
        timeout,
    )
    return taken[0]


class Outsider:
    """Reads topics, writes topics and calls services of `std_srvs/Trigger` in a ROS domain."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, CONFIGURATION)
        self._participant = DomainParticipant(domain)

    def close(self) -> None:
        """Leave; what was read or written by this participant goes with it."""
        del self._participant
        del self._domain

    def subscribe(self, topic: str, kind: str, qos: Qos = VOLATILE) -> DataReader:
        reader = self._reader(f'rt{topic}', kind, qos)
        wait_until(reader.get_matched_publications, f'somebody who publishes {topic}')
        return reader

    def publish(self, topic: str, kind: str) -> DataWriter:
        writer = self._writer(f'rt{topic}', kind)
        wait_until(writer.get_matched_subscriptions, f'somebody who subscribes {topic}')
        return writer

    def client(self, service: str) -> Client:
        requests = self._writer(f'rq{service}Request', 'std_srvs/srv/Trigger_Request')
        replies = self._reader(f'rr{service}Reply', 'std_srvs/srv/Trigger_Response', VOLATILE)
        wait_until(requests.get_matched_subscriptions, f'a service {service}')
        wait_until(replies.get_matched_publications, f'a service {service}')
        made = Client(requests, replies)
        made.become_known()
        return made

    def _reader(self, name: str, kind: str, qos: Qos) -> DataReader:
        topic = Topic(self._participant, name, dds_type(kind))
        return DataReader(self._participant, topic, qos=qos)

    def _writer(self, name: str, kind: str) -> DataWriter:
        topic = Topic(self._participant, name, dds_type(kind))
        return DataWriter(self._participant, topic, qos=VOLATILE)


class Client:
    """One service, asked by writing and answered by reading."""

    def __init__(self, requests: DataWriter, replies: DataReader) -> None:
        self._requests, self._replies = requests, replies

    def ask(self) -> None:
        self._requests.write(dds_type('std_srvs/srv/Trigger_Request')(0))

    def reply(self, timeout: float = 60.0) -> tuple[bool, dict[str, Any]]:
        """Return the next reply that the service gives to anybody, whose message is JSON."""
        reply = one(self._replies, timeout)
        return bool(reply.success), json.loads(reply.message)

    def call(self) -> tuple[bool, dict[str, Any]]:
        self.ask()
        return self.reply()

    def become_known(self) -> None:
        """
        Ask until an answer comes, of a service that answers at once.

        The server may know of us a little later than we know of it; its replies are lost until
        then. Those that are merely late are waited for.
        """
        asked = answered = 0
        while not answered:
            self.ask()
            asked += 1
            assert asked < 30, 'the service does not answer'
            with suppress(AssertionError):
                while answered < asked:
                    self.reply(8.0)
                    answered += 1

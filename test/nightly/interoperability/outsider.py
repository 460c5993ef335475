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

What is known of services: the server of rmw_fastrtps takes a request's identity (writer and
sequence number) from the DDS sample, and puts it on its reply as the inline parameter `related
sample identity`, by which clients of ROS find the answer to their question. The request needs
nothing for that, so anybody can ask. The binding shows no inline parameters: an outsider sees
every reply of the service, and knows its own only if nobody else asks meanwhile.
"""

from collections.abc import Callable
from contextlib import suppress
import time
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dds_types import reply_name, request_name, topic_name, TriggerReply, TriggerRequest

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


def wait_until(condition: Callable[[], Any], what: str, timeout: float = 30.0) -> None:
    """Wait for something that another process does."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f'{what}: not within {timeout} s'
        time.sleep(0.01)


class Outsider:
    """Reads topics, writes topics and calls services of `std_srvs/Trigger` in a ROS domain."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, CONFIGURATION)
        self._participant = DomainParticipant(domain)

    def close(self) -> None:
        """Leave; what was read or written by this participant goes with it."""
        del self._participant
        del self._domain

    def subscribe(self, topic: str, message_type: Any, qos: Qos = VOLATILE) -> DataReader:
        reader = self._reader(topic_name(topic), message_type, qos)
        wait_until(reader.get_matched_publications, f'somebody who publishes {topic}')
        return reader

    def publish(self, topic: str, message_type: Any, qos: Qos = VOLATILE) -> DataWriter:
        writer = self._writer(topic_name(topic), message_type, qos)
        wait_until(writer.get_matched_subscriptions, f'somebody who subscribes {topic}')
        return writer

    def client(self, service: str) -> 'Client':
        requests = self._writer(request_name(service), TriggerRequest, VOLATILE)
        replies = self._reader(reply_name(service), TriggerReply, VOLATILE)
        wait_until(requests.get_matched_subscriptions, f'a service {service}')
        wait_until(replies.get_matched_publications, f'a service {service}')
        made = Client(requests, replies)
        # The server may know of us a little later than we know of it; its replies are lost until
        # then.
        wait_until(made.is_heard, f'an answer of {service}')
        return made

    def _reader(self, name: str, kind: Any, qos: Qos) -> DataReader:
        return DataReader(self._participant, Topic(self._participant, name, kind), qos=qos)

    def _writer(self, name: str, kind: Any, qos: Qos) -> DataWriter:
        return DataWriter(self._participant, Topic(self._participant, name, kind), qos=qos)


class Client:
    """One service, asked by writing and answered by reading."""

    def __init__(self, requests: DataWriter, replies: DataReader) -> None:
        self._requests = requests
        self._replies = replies

    def ask(self) -> None:
        self._requests.write(TriggerRequest())

    def reply(self) -> TriggerReply:
        """Return the next reply that the service gives to anybody."""
        return one(self._replies)

    def call(self) -> TriggerReply:
        self.ask()
        return self.reply()

    def is_heard(self) -> bool:
        """Ask, and see whether an answer comes within some seconds."""
        self.ask()
        with suppress(AssertionError):
            return one(self._replies, 4.0) is not None
        return False


def one(reader: DataReader, timeout: float = 20.0) -> Any:
    """Return the next message."""
    taken: list[Any] = []

    def arrived() -> bool:
        taken.extend(reader.take(N=1))
        return bool(taken)

    wait_until(arrived, f'a message on {reader.topic.name}', timeout)
    return taken[0]

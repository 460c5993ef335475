# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Deferred answers and the worker that gives them, under both executors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import threading
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from ros_harness import Ros
from std_srvs.srv import Trigger
from tdm_planner.nodes.deferred_service import Answer, DeferredService
from tdm_planner.nodes.qos import SERVICE
from tdm_planner.nodes.runtime import make_executor
from tdm_planner.nodes.worker import Worker


class Server:
    """A node served in a thread of its own; `release` lets its worker finish."""

    def __init__(self, domain: int, make: Callable[..., Any]) -> None:
        # Names of its own, so that nobody takes a server that has ended for this one.
        self.name = f'think_{make.__name__.lower()}'
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(f'{self.name}_server', context=self.context)
        self.release = threading.Event()
        self.worker = Worker(self.node)
        self.threads: set[int] = set()
        self.service = DeferredService(self.node, Trigger, self.name, self.handle)
        self.executor = make(context=self.context)
        self.executor.add_node(self.node)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        while not self.stop.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def handle(self, _: Any, response: Trigger.Response, answer: Answer) -> None:
        if self.worker.busy:
            response.message = 'busy'
            answer(response)
            return

        def done(outcome: str) -> None:
            self.threads.add(threading.get_ident())
            response.message = outcome
            answer(response)

        self.worker.submit(self.think, done)

    def think(self) -> str:
        assert self.release.wait(10.0)
        return 'thought'

    def close(self) -> None:
        self.stop.set()
        self.thread.join()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(params=[make_executor, SingleThreadedExecutor], ids=['default', 'single'])
def server(ros: Ros, request: pytest.FixtureRequest) -> Iterator[Server]:
    made = Server(ros.domain, request.param)
    yield made
    made.release.set()
    made.close()


def test_others_are_served_until_the_answer_is_ready(ros: Ros, server: Server) -> None:
    first = ros.request(server.name, Trigger)
    assert ros.spin_until(lambda: server.worker.busy)
    assert ros.call(server.name, Trigger).message == 'busy'
    assert not first.done()
    server.release.set()
    assert ros.spin_until(first.done)
    assert first.result().message == 'thought'
    assert server.threads == {server.thread.ident}
    assert ros.call(server.name, Trigger).message == 'thought'


def test_an_outcome_waits_for_the_executor(ros: Ros) -> None:
    outcomes: list[str] = []
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros.domain)
    node = rclpy.create_node('early', context=context)
    Worker(node).submit(lambda: 'early', outcomes.append)
    executor = make_executor(context)
    executor.add_node(node)
    for _ in range(100):
        executor.spin_once(timeout_sec=0.05)
        if outcomes:
            break
    assert outcomes == ['early']
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_every_request_of_a_burst_is_answered(ros: Ros) -> None:
    """As when many clients ask while the node is held up: none may be left waiting for ever."""
    burst = 60
    server = rclpy.create_node('held_up', context=ros._context)
    DeferredService(server, Trigger, 'burst', lambda _, response, answer: answer(response))
    client = ros.node.create_client(Trigger, 'burst', qos_profile=SERVICE)
    assert ros.spin_until(client.service_is_ready)
    ros.spin_for(0.2)
    asked = [client.call_async(Trigger.Request()) for _ in range(burst)]
    ros.spin_for(0.5)  # all requests arrive before the server looks at the first
    executor = SingleThreadedExecutor(context=ros._context)
    executor.add_node(server)
    for _ in range(10 * burst):
        executor.spin_once(timeout_sec=0.0)
    assert ros.spin_until(lambda: all(future.done() for future in asked), 5.0), (
        f'{sum(future.done() for future in asked)} of {burst} answered'
    )
    executor.shutdown()
    server.destroy_node()

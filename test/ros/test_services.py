# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Answers of services: of a queue that computes, or sent again where the middleware gave up."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import threading
from typing import Any
import warnings

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock
from rclpy.executors import SingleThreadedExecutor
from rclpy.service import Service
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.exceptions import Busy
from tdm_planner.nodes.diagnostics import Level, Report
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.plan_queue import PlanQueue
from tdm_planner.nodes.runtime import make_executor
from tdm_planner.nodes.services import Answer, ATTEMPTS, create_deferred_service

REQUESTS = {
    'think': (Trigger, Trigger.Request()),
    'at_once': (Trigger, Trigger.Request()),
    'stranger/get_state': (GetState, GetState.Request()),
    'stranger/change_state': (
        ChangeState,
        ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE)),
    ),
    'stranger/get_parameters': (GetParameters, GetParameters.Request(names=['autostart'])),
}


class Stranger(ManagedNode):
    """A node that only serves; for `think` its queue waits for `release`."""

    def __init__(self, **options: Any) -> None:
        super().__init__('stranger', 'stranger', {}, **options)
        self.queue, self.release = PlanQueue(self), threading.Event()
        self.create_service(Trigger, 'at_once', lambda _, response: response)
        create_deferred_service(self, Trigger, 'think', self.on_request)
        self.bring_up()

    def configure(self) -> None:
        pass

    activate = deactivate = cleanup = configure

    def report(self) -> Report:
        return Report(Level.OK, 'active')

    def on_request(self, _: Any, answer: Answer) -> None:
        def done(thought: bool) -> None:
            assert threading.current_thread() is threading.main_thread()
            answer(Trigger.Response(success=thought, message='thought'))

        try:
            self.queue.request(lambda: self.release.wait(20.0), done)
        except Busy as error:
            answer(Trigger.Response(message=error.code))


class Server:
    """Serves a node by the executor that `make` makes, and the test's own node."""

    def __init__(self, ros: Stepped, make: Callable[..., Any], node: Any) -> None:
        self.ros, self.node = ros, node
        self.executor = make(context=ros._context)
        self.executor.add_node(node)

    def serve_until(self, condition: Callable[[], bool], rounds: int = 2000) -> bool:
        for _ in range(rounds):
            if condition():
                return True
            self.executor.spin_once(timeout_sec=0.01)
            while self.ros._serve():
                pass
        return condition()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()


class Middleware:
    """Gives up the first `lost` answers to whoever asks."""

    lost = attempts = 0

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        really_send = Service.send_response

        def send(service: Service, response: Any, header: Any) -> None:
            self.attempts += 1
            if self.attempts > self.lost:
                really_send(service, response, header)
            else:
                told = 'failed to send response (timeout): client will not receive response'
                warnings.warn(told, RuntimeWarning, stacklevel=1)

        monkeypatch.setattr(Service, 'send_response', send)
        monkeypatch.setattr('tdm_planner.nodes.services.RETRY', 0.01)
        monkeypatch.setattr('tdm_planner.nodes.clocks.Clock', Clock)  # one that runs


@pytest.fixture
def middleware(monkeypatch: pytest.MonkeyPatch) -> Middleware:
    return Middleware(monkeypatch)


@pytest.fixture
def server(ros: Stepped, make: Any, middleware: Middleware) -> Iterator[Server]:
    made = Server(ros, make, Stranger(context=ros._context))
    yield made
    made.node.release.set()
    made.close()


@pytest.mark.parametrize(
    ('service', 'lost'), [*((service, 2) for service in REQUESTS), ('at_once', 1000)]
)
@pytest.mark.parametrize('make', [make_executor, SingleThreadedExecutor])
def test_an_answer_that_the_middleware_gives_up_is_sent_again(
    ros: Stepped, server: Server, middleware: Middleware, service: str, lost: int
) -> None:
    """As when a service does not know its client yet."""
    server.node.release.set()
    middleware.lost = lost
    kind, request = REQUESTS[service]
    answer = ros.request(service, kind, request)
    attempts = min(lost + 1, ATTEMPTS)
    assert server.serve_until(lambda: middleware.attempts == attempts)
    arrives = lost < ATTEMPTS
    assert server.serve_until(answer.done, 2000 if arrives else 10) == arrives
    assert middleware.attempts == attempts


@pytest.mark.parametrize('make', [SingleThreadedExecutor])
def test_every_request_of_a_burst_is_answered(ros: Stepped, server: Server) -> None:
    """As when many clients ask while the node is held up: none may be left waiting for ever."""
    client = ros.node.create_client(Trigger, 'think', qos_profile=SERVICE)
    assert ros.meet(client.service_is_ready)
    asked = [client.call_async(Trigger.Request()) for _ in range(60)]
    ros.settle()  # all requests arrive before the server looks at the first
    assert server.serve_until(lambda: sum(future.done() for future in asked) == 59)
    server.node.release.set()
    assert server.serve_until(lambda: all(future.done() for future in asked))
    assert sorted({future.result().message for future in asked}) == ['BUSY', 'thought']

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Answers the middleware gives up, as when a service does not know its client yet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
import warnings

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.service import Service
from ros_harness import Ros
from std_srvs.srv import Trigger
from tdm_planner.nodes.answers import ATTEMPTS
from tdm_planner.nodes.deferred_service import DeferredService
from tdm_planner.nodes.diagnostics import Level, Report
from tdm_planner.nodes.managed import ManagedNode
from tdm_planner.nodes.runtime import make_executor

REQUESTS = {
    'deferred': (Trigger, Trigger.Request()),
    'at_once': (Trigger, Trigger.Request()),
    'stranger/get_state': (GetState, GetState.Request()),
    'stranger/change_state': (
        ChangeState,
        ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE)),
    ),
    'stranger/get_parameters': (GetParameters, GetParameters.Request(names=['autostart'])),
}


class Stranger(ManagedNode):
    """A node that does nothing but serve."""

    def __init__(self, **options: Any) -> None:
        super().__init__('stranger', 'stranger', {}, **options)
        self.create_service(Trigger, 'at_once', lambda _, response: response)
        DeferredService(self, Trigger, 'deferred', lambda _, response, answer: answer(response))
        self.bring_up()

    def configure(self) -> None:
        pass

    activate = deactivate = cleanup = configure

    def report(self) -> Report:
        return Report(Level.OK, 'active')


class Middleware:
    """Gives up the first `lost` answers to whoever asks."""

    executor: Any

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.lost, self.attempts = 0, 0
        really_send = Service.send_response

        def send(service: Service, response: Any, header: Any) -> None:
            self.attempts += 1
            if self.attempts > self.lost:
                really_send(service, response, header)
            else:
                told = 'failed to send response (timeout): client will not receive response'
                warnings.warn(told, RuntimeWarning, stacklevel=1)

        monkeypatch.setattr(Service, 'send_response', send)


@pytest.fixture(params=[make_executor, SingleThreadedExecutor], ids=['default', 'single'])
def middleware(
    ros: Ros, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Iterator[Middleware]:
    monkeypatch.setattr('tdm_planner.nodes.answers.RETRY', 0.01)
    made = Middleware(monkeypatch)
    node = Stranger(context=ros._context)
    made.executor = request.param(context=ros._context)
    made.executor.add_node(node)
    yield made
    made.executor.shutdown()
    node.destroy_node()


LOST = [*((service, 2) for service in REQUESTS), ('at_once', 1000)]


@pytest.mark.parametrize(('service', 'lost'), LOST)
def test_it_is_sent_again(ros: Ros, middleware: Middleware, service: str, lost: int) -> None:
    middleware.lost = lost
    kind, request = REQUESTS[service]
    answer = ros.request(service, kind, request)
    for _ in range(100):
        middleware.executor.spin_once(timeout_sec=0.02)
        if middleware.attempts == min(lost + 1, ATTEMPTS):
            break
    middleware.executor.spin_once(timeout_sec=0.1)
    assert middleware.attempts == min(lost + 1, ATTEMPTS)
    assert ros.spin_until(answer.done, 1.0) == (lost < ATTEMPTS)

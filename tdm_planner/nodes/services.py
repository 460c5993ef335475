# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Requests for plans, and services that answer every client.

The latter are workarounds, with the versions until which they are needed:

- A client may discover a service before the service discovers it. rmw_fastrtps then drops the
  response after a tenth of a second, rclpy warns, and the client waits for ever. Here the response
  is sent again (https://github.com/ros2/rmw_fastrtps/issues/842, not fixed in any release yet).
- rclpy's own services raise on malformed requests: for an unknown transition (until rclpy 8.0.0)
  or an unknown parameter type (in every release so far). That would end the node. Here the
  response says that nothing was done.
- A callback that answers later would be a coroutine; the EventsExecutor of Jazzy does not run it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
import warnings

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from tdm_planner.exceptions import Failure, one_line
from tdm_planner.nodes.clocks import steady_timer
from tdm_planner.nodes.messages import SERVICE

RETRY = 0.2  # s until an answer is sent again; doubled each time, as an attempt holds the node up
ATTEMPTS = 6

Answer = Callable[[str | Failure], None]


def answer_reliably(node: Node, service: Any) -> None:
    """
    Let a service resend a dropped response, up to `ATTEMPTS` times.

    Executors pass the result of a callback to the service's `send_response`, with the header that
    names the client; `send_response` is replaced.
    """
    send = service.send_response

    def answer(response: Any, header: Any, attempts: int = ATTEMPTS) -> None:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter('always')
            send(response, header)
        if not any('failed to send response' in str(one.message) for one in told):
            return
        if attempts == 1:
            node.get_logger().warning(
                f'the answer of {service.srv_name} did not reach the client that asked'
            )
            return

        def again() -> None:
            node.destroy_timer(timer)
            answer(response, header, attempts - 1)

        timer = steady_timer(node, RETRY * 2.0 ** (ATTEMPTS - attempts), again)

    service.send_response = answer


def answer_malformed_requests(node: Node, service: Any) -> None:
    """Let one of rclpy's own services answer requests on which its callback raises."""
    callback = service.callback

    def guarded(request: Any, response: Any) -> Any:
        parameters = getattr(request, 'parameters', [])  # to be set
        try:
            for item in parameters:
                Parameter.from_parameter_msg(item)
            return callback(request, response)
        except Exception as error:  # noqa: B902
            reason = f'the request cannot be read: {one_line(error)}'
            node.get_logger().warning(f'{service.srv_name}: {reason}')
            rejected = SetParametersResult(successful=False, reason=reason)
            if service.srv_type is SetParameters:
                return SetParameters.Response(results=[rejected for _ in parameters])
            if service.srv_type is SetParametersAtomically:
                return SetParametersAtomically.Response(result=rejected)
            return service.srv_type.Response()

    service.callback = guarded


@dataclass(frozen=True, eq=False)
class Request:
    """
    Who asked for a plan, and for which.

    `answer` gets the figures of the plan as JSON, or why there is none; None if no client waits:
    plans of reviews, recovered plans. `changes` are parameters to plan with instead of the node's:
    for this plan alone, or, if they are `lasting`, set on the node with the plan. `title` begins
    the log's line about a failure.
    """

    answer: Answer | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    lasting: bool = False
    title: str = 'no plan'


def create_plan_service(
    node: Node,
    service_type: type[Trigger] | type[SetParametersAtomically],
    name: str,
    handler: Callable[[Request, Sequence[Any]], None],
) -> None:
    """
    Serve `name`; `handler(request, parameters)` calls `request.answer` once, now or later.

    rclpy sends at once what a service's callback returns. Here the callback returns the request
    itself, and `send_response` is replaced: it hands that to `handler` instead of sending it.
    """

    def receive(message: Any, header: Any) -> None:
        def answer(outcome: str | Failure) -> None:
            success = not isinstance(outcome, Failure)
            text = outcome.to_json() if isinstance(outcome, Failure) else outcome
            if service_type is Trigger:
                response = Trigger.Response(success=success, message=text)
            else:
                result = SetParametersResult(successful=success, reason=text)
                response = SetParametersAtomically.Response(result=result)
            send(response, header)

        handler(Request(answer), getattr(message, 'parameters', ()))

    service: Any = node.create_service(
        service_type, name, lambda request, _: request, qos_profile=SERVICE
    )
    send, service.send_response = service.send_response, receive

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Answers of services that reach their client though it was met only just now.

A client may know the service before the service knows where to answer. The middleware gives such
an answer up after a tenth of a second, and the client would wait for ever.
"""

from __future__ import annotations

from typing import Any
import warnings

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

RETRY = 0.2  # s until an answer is sent again; doubled each time, as an attempt holds the node up
ATTEMPTS = 6


def send_until_it_arrives(node: Node, service: Any) -> None:
    """
    Let a service of a node send an answer that was given up again, up to `ATTEMPTS` times.

    Both executors hand what a callback returns to the service's `send_response`, together with
    the header that says who asked; it is replaced.
    """
    send = service.send_response

    def answer(response: Any, header: Any, attempts: int = ATTEMPTS) -> None:
        if _is_sent(send, response, header):
            return
        if attempts == 1:
            node.get_logger().warning(
                f'the answer of {service.srv_name} did not reach the client that asked'
            )
            return

        def again() -> None:
            node.destroy_timer(timer)
            answer(response, header, attempts - 1)

        wait = RETRY * 2.0 ** (ATTEMPTS - attempts)
        timer = node.create_timer(wait, again, clock=Clock(clock_type=ClockType.STEADY_TIME))

    service.send_response = answer


def _is_sent(send: Any, response: Any, header: Any) -> bool:
    # rclpy tells of an answer that was given up only by a warning.
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        send(response, header)
    return not any('failed to send response' in str(one.message) for one in told)

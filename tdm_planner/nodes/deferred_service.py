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

"""A service that answers later, while the executor serves everything else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.node import Node
from tdm_planner.nodes.qos import SERVICE

Answer = Callable[[Any], None]


class _Deferred(NamedTuple):
    request: Any
    response: Any


class DeferredService:
    """
    Calls `handler(request, response, answer)`; the handler answers when it is ready.

    `answer(response)` may be called at once or later, once, from the executor's thread.

    A coroutine as callback would do the same, but EventsExecutor does not run it, and
    SingleThreadedExecutor polls it at full load. Both executors hand what a callback returns to
    the service's `send_response` together with the header that says who asked; it is held back
    there.
    """

    def __init__(
        self,
        node: Node,
        service_type: Any,
        name: str,
        handler: Callable[[Any, Any, Answer], None],
    ) -> None:
        self._handler = handler
        # Any: rclpy declares that a callback returns the response itself.
        self._service: Any = node.create_service(
            service_type, name, _Deferred, qos_profile=SERVICE
        )
        self._send = self._service.send_response
        self._service.send_response = self._hold_back

    def _hold_back(self, deferred: _Deferred, header: Any) -> None:
        self._handler(
            deferred.request, deferred.response, lambda response: self._send(response, header)
        )

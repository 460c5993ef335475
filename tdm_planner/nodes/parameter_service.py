# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The parameter services of a node, which a malformed request must not end.

rclpy's own raise out of their callbacks where a request holds a type that does not exist, and so
end the node.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService


class GuardedParameterService(ParameterService):
    """The services of rclpy; what cannot be set is answered with a reason."""

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        response.results = [self._set([item]) for item in request.parameters]
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        response.result = self._set(request.parameters)
        return response

    def _set(self, messages: Sequence[Any]) -> SetParametersResult:
        try:
            parameters = [Parameter.from_parameter_msg(message) for message in messages]
            return self._get_node().set_parameters_atomically(parameters)
        except Exception as error:  # noqa: B902
            # Whatever a request holds, the node keeps serving.
            sentence = ' '.join(str(error).split())
            return SetParametersResult(
                successful=False, reason=f'the request cannot be read: {sentence}'
            )

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
The parameter services of a node, which a malformed request must not end.

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

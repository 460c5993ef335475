# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A node with one parameter of every kind, for the tests of parameters and of the runtime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import sys
import threading
import time
from typing import Any

from std_srvs.srv import Trigger
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.ros_parameters import ParameterNode
from tdm_planner.nodes.runtime import run
from tdm_planner.parameters import parameter, POSITIVE, Range, specifications, Validated


@dataclass(frozen=True)
class ExampleParameters(Validated):
    mass: float = parameter(1.0, 'mass of the thing', unit='kg', allowed=POSITIVE)
    count: int = parameter(3, 'how many', allowed=Range(0, 8, lower_open=True))
    turns: int | None = parameter(None, 'turns, or unset')
    kind: str = parameter('fast', 'which', choices=('fast', 'slow'))
    names: list[str] = parameter(['a', 'b'], 'names')
    weights: list[float] = parameter([], 'weights', allowed=POSITIVE)
    switch: bool = parameter(False, 'on or off')
    fixed: str = parameter('here', 'cannot be changed', read_only=True)


class ExampleNode(ParameterNode):
    """A node with nothing but parameters."""

    def __init__(self, **options: Any) -> None:
        super().__init__('example', specifications(ExampleParameters), **options)
        self.warn_of_unknown_overrides()
        self.create_service(Trigger, '~/values', self._values_service)
        self.create_service(Trigger, '~/fail', self._fail)
        self.create_service(Trigger, '~/compute', self._compute)

    def check_values(self, values: Mapping[str, Any]) -> None:
        if values['mass'] > 100 and values['kind'] == 'fast':
            raise InvalidProblem('a mass above 100 kg cannot be fast')

    def _values_service(self, _: Any, response: Any) -> Any:
        response.message = repr((self.parameter_values, dict(self.invalid_overrides)))
        return response

    def _fail(self, _: Any, response: Any) -> Any:
        raise RuntimeError('something\nbroke')

    def _compute(self, _: Any, response: Any) -> Any:
        threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
        return response


if __name__ == '__main__':
    sys.exit(run(ExampleNode))

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Performance indices with kinks, such as |u|, rounded off: Ipopt needs second derivatives.

A graph is written again with sqrt(a^2 + e^2) in place of |a|, likewise where a maximum, minimum,
square root or hypotenuse has its kink.
"""

from __future__ import annotations

from typing import Any

import casadi as ca


class Rounded:
    """
    A traced function f(..., p) with rounded kinks.

    `value` (..., p, e) -> f, with e (k,) how far each kink is rounded; `sizes` (..., p) -> (k,)
    what stands in every kink, to choose e by; `count` is k.
    """

    def __init__(self, function: Any) -> None:
        given = function.sx_in()
        found: list[Any] = [None] * function.sz_w()
        radius: list[Any] = []
        inside: list[Any] = []
        results = [ca.SX.zeros(function.size_out(i)) for i in range(function.n_out())]

        def root(square: Any, size: Any) -> Any:
            radius.append(ca.SX.sym('e'))
            inside.append(size)
            return ca.sqrt(square + radius[-1] ** 2)

        for index in range(function.n_instructions()):
            operation = function.instruction_id(index)
            takes, gives = function.instruction_input(index), function.instruction_output(index)
            if operation == ca.OP_CONST:
                found[gives[0]] = ca.SX(function.instruction_constant(index))
            elif operation == ca.OP_INPUT:
                found[gives[0]] = given[takes[0]].nz[takes[1]]
            elif operation == ca.OP_OUTPUT:
                results[gives[0]].nz[gives[1]] = found[takes[0]]
            else:
                values = [found[place] for place in takes]
                found[gives[0]] = _operated(operation, values, root)
        self.count = len(radius)
        e = ca.vertcat(ca.SX(0, 1), *radius)
        self.value = ca.Function('rounded', [*given, e], results)
        self.sizes = ca.Function('kinks', given, [ca.vertcat(ca.SX(0, 1), *inside)])


def _operated(operation: int, values: list[Any], root: Any) -> Any:
    a, b = values[0], values[-1]
    if operation == ca.OP_FABS:
        return root(a**2, a)
    if operation == ca.OP_SQRT:
        return root(a, ca.sqrt(a))
    if operation == ca.OP_HYPOT:
        return root(a**2 + b**2, ca.hypot(a, b))
    if operation in (ca.OP_FMAX, ca.OP_FMIN):
        apart = root((a - b) ** 2, a - b)
        return 0.5 * (a + b + (apart if operation == ca.OP_FMAX else -apart))
    return ca.SX.unary(operation, a) if len(values) == 1 else ca.SX.binary(operation, a, b)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""CasADi's functions as the engine calls them: on numpy arrays, with exact derivatives."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Call:
    """A CasADi function on numpy arrays without copies, for `count` nodes at once if given."""

    def __init__(self, function: Any, count: int | None = None) -> None:
        mapped = function if count is None else function.map(count)
        self._buffer, self._run = mapped.buffer()

        def flat(size: tuple[int, int]) -> tuple[int, ...]:
            return (size[0] * size[1],) if count is None else (size[1], size[0])

        self._given = [np.zeros(flat(mapped.size_in(i))) for i in range(mapped.n_in())]
        self._found = [np.zeros(flat(mapped.size_out(i))) for i in range(mapped.n_out())]
        for arrays, attach in (
            (self._given, self._buffer.set_arg),
            (self._found, self._buffer.set_res),
        ):
            for index, values in enumerate(arrays):
                buffer: Any = values
                if values.size:
                    attach(index, memoryview(buffer))

    def __call__(self, *arguments: Any) -> list[Array]:
        """Return the values, (m,) each, or (count, m); they are overwritten by the next call."""
        for values, argument in zip(self._given, arguments, strict=True):
            values[...] = argument
        self._run()
        return self._found


class Differentiated:
    """A vector f(x; p), its Jacobian, and the Hessian of l'f: dense CasADi functions."""

    def __init__(self, name: str, x: Any, p: Any, f: Any) -> None:
        multipliers = ca.SX.sym('l', f.numel())
        jacobian = ca.densify(ca.jacobian(f, x))
        hessian = ca.densify(ca.hessian(ca.dot(multipliers, f), x)[0])
        f = ca.densify(f)
        self.value = ca.Function(name, [x, p], [f])
        # Rows contiguous in memory.
        self.linear = ca.Function(f'{name}_j', [x, p], [f, jacobian.T.reshape((-1, 1))])
        self.second = ca.Function(f'{name}_h', [x, p, multipliers], [hessian.reshape((-1, 1))])

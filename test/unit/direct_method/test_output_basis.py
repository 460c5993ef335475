# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method import Output, SineSeries, symmetric_powers
from tdm_planner.direct_method.output_basis import output_basis
from tdm_planner.exceptions import InvalidProblem


@given(st.integers(0, 4), st.integers(0, 4), st.integers(0, 12))
@settings(deadline=None, max_examples=40, derandomize=True)
def test_conditions_hold_and_free_shapes_are_orthonormal(at_start, at_end, free):
    if at_start + at_end + free == 0:
        return
    output = Output((1.0,) * at_start, (1.0,) * at_end, free)
    basis = output_basis('x', output, 0)
    assert basis.size == free
    for s, orders, offset in ((0.0, basis.start, 0), (1.0, basis.end, at_start)):
        for index, order in enumerate(orders):
            unit = np.eye(at_start + at_end)[offset + index]
            np.testing.assert_allclose(basis.given(s, order), unit, atol=1e-9)
            np.testing.assert_allclose(basis.varied(s, order), 0.0, atol=1e-7)
    points, weights = np.polynomial.legendre.leggauss(40)
    s = (points + 1) / 2
    gram = sum(basis.varied(s, k).T @ (weights[:, None] / 2 * basis.varied(s, k)) for k in (0, 2))
    np.testing.assert_allclose(gram, np.eye(free), atol=1e-7)


def test_conditions_with_a_gap():
    output = Output(start=(0.0, None, 2.0), end={0: 1.0}, free=1)
    basis = output_basis('x', output, 0)
    assert basis.start == (0, 2)
    np.testing.assert_allclose(basis.varied(0.0, 2), 0.0, atol=1e-12)
    assert abs(basis.varied(0.0, 1)).max() > 0.1


@pytest.mark.parametrize(
    ('output', 'degree', 'words'),
    [
        (Output(), 0, "output 'x'.*at least one boundary condition"),
        (Output(start=(0.0, None, 1.0), end=(0.0,)), 2, 'all lower ones must be given'),
        (Output((0.0, 1.0), (0.0, 1.0), shapes=SineSeries(1)), 0, '1 shapes cannot meet'),
        (Output((0.0, 1.0), (0.0, 1.0), shapes=symmetric_powers(5)), 0, 'cannot meet'),
        (Output((), (0.0,), shapes=SineSeries(3)), 0, 'value at the start is missing'),
    ],
)
def test_mistakes_are_named(output, degree, words):
    with pytest.raises(InvalidProblem, match=words):
        output_basis('x', output, degree)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import numpy as np
import pytest
from tdm_planner.direct_method.differentiation import (
    absolute,
    arctan2,
    choose_scheme,
    jacobians,
)

POINTS = np.array([[0.3, -1.2], [2.0, 0.5]])


def smooth(x):
    return np.stack([np.sin(x[:, 0]) * x[:, 1], np.exp(x[:, 0]), x[:, 1] ** 3], axis=1)


def exact(x, y):
    return [[np.cos(x) * y, np.sin(x)], [np.exp(x), 0.0], [0.0, 3 * y**2]]


@pytest.mark.parametrize(('scheme', 'accuracy'), [('complex_step', 1e-15), ('central', 1e-8)])
def test_both_schemes(scheme, accuracy):
    found = jacobians(smooth, POINTS, scheme)
    np.testing.assert_allclose(found, [exact(*point) for point in POINTS], atol=10 * accuracy)


def test_complex_step_is_taken_where_it_works():
    assert choose_scheme(smooth, POINTS[0]) == 'complex_step'


@pytest.mark.parametrize(
    'function', [lambda x: np.abs(x), lambda x: np.arctan2(x, 1.0), lambda x: np.real(x) ** 2]
)
def test_differences_where_it_does_not(function):
    assert choose_scheme(function, POINTS[0]) == 'central'


def test_functions_that_let_a_complex_step_pass():
    def function(x):
        return np.stack([arctan2(x[:, 1], x[:, 0]), absolute(x[:, 1])], axis=1)

    assert choose_scheme(function, POINTS[0]) == 'complex_step'
    x, y = POINTS[0]
    square = x**2 + y**2
    expected = [[-y / square, x / square], [0.0, -1.0]]
    np.testing.assert_allclose(jacobians(function, POINTS[:1], 'complex_step')[0], expected)
    assert arctan2(-1.0, -1.0) == np.arctan2(-1.0, -1.0)
    np.testing.assert_array_equal(absolute(np.array([-2.0, 3.0])), [2.0, 3.0])

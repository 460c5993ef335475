# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What holds for every family of reference functions alike."""

import numpy as np
import pytest
from tdm_planner.direct_method import (
    PolynomialReference,
    power_products,
    ReferenceFunction,
    SineSeries,
    SpeedFactor,
    symmetric_powers,
    TaranenkoReference,
)

START, END = {0: 1.0, 1: -0.5}, {0: 2.0, 1: 0.3}
FAMILIES: dict[str, ReferenceFunction] = {
    'polynomial': PolynomialReference({**START, 2: 0.7}, {**END, 3: 1.0}, 3.0, 1.0),
    'sines': TaranenkoReference(SineSeries(5), START, END, 3.0, 1.0, [0.2, -0.1, 0.3]),
    'powers': TaranenkoReference(
        symmetric_powers(3) + power_products([(1, 2)]), START, END, 3.0, 1.0, [0.4, -2.0]
    ),
    'products': TaranenkoReference(
        power_products([(1, 2), (2, 1), (2, 2)]), START, END, 3.0, 1.0, [0.5]
    ),
    'speed factor': SpeedFactor([1.0, 2.0, 0.5, 1.5], 3.0, 1.0),
}


@pytest.fixture(params=FAMILIES.values(), ids=list(FAMILIES))
def x(request):
    return request.param


def test_all_are_called_alike(x):
    assert isinstance(x, ReferenceFunction)
    for shape in ((), (0,), (5,), (2, 3), (2, 1, 4)):
        tau = np.linspace(1.0, 3.0, int(np.prod(shape))).reshape(shape)
        for order in range(4):
            assert x(tau, order).shape == shape
            assert x.jacobian(tau, order).shape[:-1] == shape
            np.testing.assert_array_equal(x(tau, order).ravel(), x(tau.ravel(), order))


def test_every_order_is_the_derivative_of_the_one_below(x):
    tau, step = np.linspace(1.1, 2.9, 12), 1e-5
    for order in (1, 2, 3, 4):
        slope = (x(tau + step, order - 1) - x(tau - step, order - 1)) / (2 * step)
        scale = 1 + np.abs(slope).max()
        np.testing.assert_allclose(x(tau, order), slope, atol=1e-6 * scale)


def test_the_derivative_by_the_parameters_is_the_same_wherever_they_are(x):
    """Each function is linear in them: what is varied adds its share, whatever the rest."""
    tau = np.linspace(1.0, 3.0, 7)
    for order in range(3):
        jacobian = x.jacobian(tau, order)
        if isinstance(x, TaranenkoReference):
            change = np.arange(1.0, 1.0 + len(x.varied))
            moved = x.with_varied(x.varied + change)
            np.testing.assert_array_equal(moved.jacobian(tau, order), jacobian)
            difference = moved(tau, order) - x(tau, order)
        elif isinstance(x, SpeedFactor):
            change = np.arange(1.0, 1.0 + x.coefficients.size)
            moved = SpeedFactor(x.coefficients + change, x.tau_f, x.tau_0)
            difference = moved(tau, order) - x(tau, order)
        else:
            change = np.array([1.0, -0.5, 0.7, 2.0, 0.3, 1.0])
            difference = x(tau, order)
        np.testing.assert_allclose(jacobian @ change, difference, atol=1e-10)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import quad
from tdm_planner.tracking.feedforward import Feedforward
from tdm_planner.trajectory import Interpolation, Trajectory


def trajectory(controls: list[float], interpolation: Interpolation) -> Trajectory:
    times = np.cumsum([0.0, 0.11, 0.07, 0.2, 0.05, 0.13])
    return Trajectory(
        times, np.zeros((6, 1)), np.array(controls)[:, None], ('x',), ('u',), interpolation
    )


def test_the_mean_of_a_bang_bang_torque_is_exact() -> None:
    feedforward = Feedforward(trajectory([1, -1, 1, -1, 1, 1], 'zero_order_hold'))
    assert feedforward.mean(0.0, 0.1) == pytest.approx(1.0)
    assert feedforward.mean(0.10, 0.12) == pytest.approx(0.0, abs=1e-12)
    assert feedforward.mean(0.11, 0.19) == pytest.approx((-0.07 + 0.01) / 0.08)
    # before the start and after the end nothing is planned
    assert feedforward.mean(-0.02, 0.02) == pytest.approx(0.5)
    assert feedforward.mean(0.55, 0.57) == pytest.approx(0.5)
    assert feedforward.mean(0.6, 0.7) == pytest.approx(0.0)


@pytest.mark.parametrize('interpolation', ['zero_order_hold', 'linear', 'cubic'])
@settings(deadline=None, max_examples=15, derandomize=True)
@given(
    controls=st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    start=st.floats(0.0, 0.5),
    span=st.floats(1e-3, 0.05),
)
def test_the_mean_agrees_with_quadrature(
    interpolation: Interpolation, controls: list[float], start: float, span: float
) -> None:
    plan = trajectory(controls, interpolation)
    inside = [t for t in plan.times if start < t < start + span]
    integral, _ = quad(
        lambda t: float(plan.sample(t).control[0]), start, start + span, points=inside or None
    )
    mean = Feedforward(plan).mean(start, start + span)
    assert mean.shape == (1,)
    assert mean[0] == pytest.approx(integral / span, abs=1e-6)

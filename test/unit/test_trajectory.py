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
from scipy.integrate import quad
from scipy.interpolate import PPoly
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.trajectory import to_nanoseconds, Trajectory


def make(times=(0.0, 1.0, 3.0), interpolation='zero_order_hold', controls=(1.0, -1.0, 0.0)):
    """Return a double integrator under the given controls, exact for held ones."""
    times, u = np.array(times), np.array(controls)
    states = np.zeros((times.size, 2))
    for k in range(times.size - 1):
        h = times[k + 1] - times[k]
        x, v = states[k]
        states[k + 1] = x + v * h + u[k] * h**2 / 2, v + u[k] * h
    return Trajectory(times, states, u[:, None], ('x', 'v'), ('u',), interpolation)


def derivative(state, control):
    return np.concatenate([state[..., 1:], control], axis=-1)


def test_held_controls_act_from_their_sample_to_the_next():
    trajectory = make()
    read = trajectory.sample([-1.0, 0.0, 0.999, 1.0, 2.9, 3.0, 9.0]).control[:, 0]
    np.testing.assert_array_equal(read, [1, 1, 1, -1, -1, 0, 0])


def test_states_between_samples_are_exact_for_a_double_integrator():
    trajectory = make().with_rates(derivative)
    t = np.linspace(0, 1, 9)
    np.testing.assert_allclose(trajectory.sample(t).state[:, 0], t**2 / 2, atol=1e-15)
    np.testing.assert_allclose(trajectory.sample(2.0).state, [1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(trajectory.rates[0, 1], [1.0, 1.0])
    np.testing.assert_allclose(trajectory.rates[1, 0], [1.0, -1.0])


def test_linear_and_cubic_controls():
    times = np.linspace(0, 2, 9)
    linear = make(times, 'linear', times)
    assert linear.sample(0.1).control[0] == pytest.approx(0.1)
    cubic = make(times, 'cubic', times**3)
    assert cubic.sample(0.3).control[0] == pytest.approx(0.027)


def test_samples_cannot_be_changed():
    trajectory = make()
    with pytest.raises(ValueError, match='read-only'):
        trajectory.times[0] = 5.0


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'times': (0.0, 1.0, 1.0)}, 'increase strictly'),
        ({'times': (0.0,), 'controls': (1.0,)}, 'at least two'),
        ({'controls': (1.0, np.nan, 0.0)}, 'not finite'),
        ({'interpolation': 'spline'}, 'zero_order_hold, linear, cubic'),
    ],
)
def test_malformed_trajectories_are_refused(changes, words):
    with pytest.raises(InvalidProblem, match=words):
        make(**changes)


def test_times_are_rounded_to_what_messages_can_carry():
    times = to_nanoseconds([0.1234567891234, 1.0])
    assert times[0] == pytest.approx(0.123456789, abs=1e-15)
    assert times[1] == 1.0


@pytest.mark.parametrize('interpolation', ['zero_order_hold', 'linear', 'cubic'])
def test_the_integral_of_the_controls_is_exact(interpolation):
    times = np.cumsum([0.0, 0.11, 0.07, 0.2, 0.05])
    trajectory = make(times, interpolation, [1.0, -2.0, 0.5, 3.0, 0.0])
    pieces = [
        quad(lambda t: float(trajectory.sample(t).control[0]), *edges)[0]
        for edges in zip(times[:-1], times[1:] - 1e-15, strict=True)
    ]
    integral = trajectory.control_integral(times)[:, 0]
    np.testing.assert_allclose(integral, np.cumsum([0.0, *pieces]), atol=1e-12)
    # Outside the samples nothing is commanded.
    outside = trajectory.control_integral([-1.0, times[-1] + 1.0])[:, 0]
    np.testing.assert_array_equal(outside, integral[[0, -1]])


@pytest.mark.parametrize('interpolation', ['zero_order_hold', 'linear', 'cubic'])
def test_integrals_are_asked_for_of_what_may_be_written_to(monkeypatch, interpolation):
    """Before 1.15 SciPy raises "buffer source array is read-only" for others."""
    antiderivative = PPoly.antiderivative

    def of_old(self, nu=1):
        assert self.x.flags.writeable
        return antiderivative(self, nu)

    monkeypatch.setattr(PPoly, 'antiderivative', of_old)
    trajectory = make(np.arange(5.0), interpolation, np.ones(5))
    assert trajectory.control_integral(4.0) == pytest.approx(4.0)

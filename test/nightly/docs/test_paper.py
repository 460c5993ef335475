# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the pages on the paper claim, and its virtual arc: derivatives, order, what it reaches."""

import sys

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from ros_harness import SOURCE
from scipy.integrate import solve_ivp
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems.swing_up_task import SwingUpTask

PLANT, TORQUE = RotaryPendulum(), 0.09
ARCS = TORQUE * np.array([-1.0, 1.0, -1.0, 1.0])


@pytest.fixture(autouse=True)
def _pages(monkeypatch):
    monkeypatch.setattr(sys, 'path', [str(SOURCE / 'docs' / 'paper'), *sys.path])


def test_every_misprint_breaks_the_energy_balance_and_the_right_equations_are_the_plants():
    import misprints

    state = np.array([0.7, 0.2, -3.0, 5.0])
    expected = PLANT.derivative(state, np.array([0.01]))[2:]
    np.testing.assert_allclose(misprints.accelerations(PLANT, state, 0.01, ()), expected)
    assert misprints.energy_error(()) < 1e-9
    for name in misprints.MISPRINTS:
        assert misprints.energy_error((name,)) > 0.1, name


def test_orders_of_the_pendulums_schemes():
    import pendulum_scheme as scheme

    switches = np.array([1.2])
    right = scheme.truth(switches)
    assert np.isnan(scheme.printed(101, switches).time)
    mended = [abs(scheme.mended(n, 1.2).time / right.time - 1) for n in (101, 401)]
    completed = [abs(scheme.printed(n, switches, True).time / right.time - 1) for n in (101, 401)]
    assert mended[1] < 1e-4
    assert mended[0] / mended[1] > 12  # second order
    assert completed[1] > 100 * mended[1]


def test_the_plant_follows_the_mended_scheme_ever_closer():
    import pendulum_scheme as scheme

    errors = list(scheme.landing_errors(0.4, 0.063, (80, 160, 320)).values())
    assert errors[0] / errors[1] > 3  # second order
    assert errors[1] / errors[2] > 3


def test_virtual_arc_works_from_above_the_horizontal_not_from_hanging_with_weak_torque():
    import pendulum_scheme as scheme

    ratios = scheme.transfers(np.array([0.8, np.pi]), np.array([0.02, 0.04]))
    assert np.isnan(ratios[:, 1]).all()
    assert (ratios[:, 0] < 1.05).all()
    assert (ratios[:, 0] > 1 - 1e-3).all()


def test_robots_scheme_misses_and_the_exact_inverse_does_not():
    import robots_scheme as robots

    for nodes in (101, 401):
        moving, resting = robots.move(velocity=0.2), robots.move()
        printed = robots.printed(moving, nodes)
        assert printed.speed_factor[1:-3] == pytest.approx(1.0, abs=0.05)
        printed = robots.printed(resting, nodes)
        assert printed.speed_factor[nodes // 2] > 1.5
        assert robots.open_loop_miss(resting, printed) > 0.5
        assert robots.open_loop_miss(resting, robots.exact(resting, nodes)) < 2e-3
    assert robots.yaw_rate_ripple(101) == pytest.approx(1.0)


def virtual_arc(start, arcs=ARCS, torque=TORQUE, steps=12, **floor):
    from virtual_arc_program import VirtualArcProgram

    task = SwingUpTask(PLANT, np.array(start), torque, torque, 2.0, None)
    return VirtualArcProgram(task, arcs, 0, steps, **floor)


@given(slope=st.floats(0.0, 2.0))
@settings(max_examples=30)
def test_the_reference_function_is_monotone_and_ends_at_rest(slope):
    from virtual_arc_program import reference_shape

    tau = np.linspace(0.0, 1.0, 401)
    values = reference_shape(tau, slope)
    assert (values[0], values[-1]) == (0.0, pytest.approx(1.0))
    assert (np.diff(values) > 0).all()
    assert values[1] / tau[1] == pytest.approx(slope, abs=0.01)
    assert (values[-1] - values[-2]) < 4 * tau[1] ** 2


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, -0.2, -9.0, 1.0)])
def test_derivatives_along_a_virtual_arc_match_finite_differences(start):
    made, xi = virtual_arc(start, floor=0.3), np.array([0.35, 0.25, 0.2])
    at = made.linearise(made.evaluate(xi), None)
    points = [(made.evaluate(xi + c), made.evaluate(xi - c)) for c in 1e-7 * np.eye(3)]
    slope = np.array([after.cost - before.cost for after, before in points]) / 2e-7
    np.testing.assert_allclose(at.gradient, slope, rtol=1e-5, atol=1e-6)
    rows = [after.cache.equalities - before.cache.equalities for after, before in points]
    np.testing.assert_allclose(
        at.equality_jacobian, np.stack(rows, axis=-1) / 2e-7, rtol=1e-4, atol=1e-5
    )


def passage(start, angle):
    """Integrate the plant to where theta reaches an angle: what the scheme integrates there."""

    def reached(t, x):
        return x[0] - angle

    reached.terminal = True
    held = np.array([-TORQUE])
    way = solve_ivp(lambda t, x: PLANT.derivative(x, held), (0.0, 3.0), start, 'DOP853',
                    events=reached, rtol=1e-11, atol=1e-12)  # fmt: skip
    _, psi, theta_dot, psi_dot = way.y[:, -1]
    return np.array([theta_dot**2, psi, psi_dot, way.t[-1]])


@pytest.mark.parametrize('start', [(3.0, 0.1, 0.0, 0.2), (3.0, 0.1, -6.0, 0.2)])
def test_the_virtual_arc_is_of_second_order_to_the_motion_of_the_plant(start):
    worst = []
    for steps in (80, 160):
        made, xi = virtual_arc(start, ARCS[:2], steps=steps), np.array([[0.35]])
        error = made.along(xi)[0, steps] - passage(start, made.angles(xi)[0, steps])
        worst.append((np.abs(error) / [100.0, 1.0, 10.0, 0.3]).max())
    assert worst[1] < 2e-4
    assert worst[0] / worst[1] > 3.0


def test_the_arcs_fill_the_time_and_what_is_beyond_reach_is_a_violation_not_a_crash():
    program, xi = virtual_arc((3.0, 0.0, -9.0, 0.0), steps=10), np.array([0.3, 0.3, 0.1])
    durations = program.durations(xi)
    assert durations.shape == (4,)
    assert durations.sum() == pytest.approx(program.along(xi[None])[0, -1, 3])
    weak = virtual_arc((np.pi, 0.0, 0.0, 0.0), ARCS / 90, 1e-3, 10, floor=1.0)
    point = weak.evaluate(np.full(3, 0.25))
    assert np.isfinite(point.cost)
    assert point.violations[1] > 0.1

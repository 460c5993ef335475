# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the pages on the paper claim, and its virtual arc: derivatives, order, what it reaches."""

import sys

import numpy as np
import pytest
from ros_harness import SOURCE
from tdm_planner.plants import RotaryPendulum

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

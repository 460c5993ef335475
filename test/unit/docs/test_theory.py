# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The equations of docs/theory.md, written down a second time, against the code."""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial
import pytest
from scipy.integrate import trapezoid
from tdm_planner.direct_method import (
    arc_derivatives,
    path_speed,
    PolynomialReference,
    PowerProducts,
    SineSeries,
    SpeedFactor,
    symmetric_powers,
    TaranenkoReference,
    time_derivatives,
    TimeFactor,
)
from tdm_planner.plants import FloatingRobot, RotaryPendulum
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.formation_verification import penalty
from tdm_planner.tracking import time_varying_regulator

RNG = np.random.default_rng(7)
S = np.linspace(0.0, 1.0, 11)


def test_quintic_has_the_coefficients_of_equation_4():
    f = 1.7
    matrix = np.array(
        [
            [1, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0],
            [1, f, f**2 / 2, f**3 / 6, f**4 / 12, f**5 / 20],
            [0, 1, f, f**2 / 2, f**3 / 3, f**4 / 4],
            [0, 0, 1, f, f**2, f**3],
        ]
    )
    given = RNG.normal(size=6)
    a = np.linalg.solve(matrix, given)
    x = Polynomial([a[0], a[1], *(a[k] / (k * (k - 1)) for k in range(2, 6))])
    reference = PolynomialReference(
        dict(enumerate(given[:3])), dict(enumerate(given[3:])), tau_f=f
    )
    for order in range(4):
        assert reference(f * S, order) == pytest.approx(
            x.deriv(order)(f * S) if order else x(f * S), rel=1e-9, abs=1e-9
        )


@pytest.mark.parametrize(
    ('shapes', 'phi'),
    [
        (SineSeries(3), lambda k, s: np.sin(k * np.pi * s)),
        (symmetric_powers(3), lambda k, s: s**k * (s - 1) ** k),
        (PowerProducts(((2, 3),)), lambda k, s: s**2 * (s - 1) ** 3),
    ],
)
def test_taranenkos_functions_are_those_of_equation_1(shapes, phi):
    a = RNG.normal(size=shapes.size)
    x = TaranenkoReference(shapes, {0: 1.0}, {0: -2.0}, tau_f=5.0, tau_0=3.0, varied=a)
    expected = 1.0 - 3.0 * S + sum(a[k - 1] * phi(k, S) for k in range(1, shapes.size + 1))
    assert x(3.0 + 2.0 * S) == pytest.approx(expected)


def test_derivatives_by_time_and_along_the_arc():
    x, x1, x2, x3 = RNG.normal(size=4)
    lam, lam1, lam2 = 1.3, -0.4, 0.7
    found = time_derivatives([x, x1, x2, x3], [lam, lam1, lam2])
    assert found[1] == pytest.approx(lam * x1)
    assert found[2] == pytest.approx(lam**2 * x2 + lam * lam1 * x1)
    third = lam**3 * x3 + 3 * lam**2 * lam1 * x2 + lam * (lam1**2 + lam * lam2) * x1
    assert found[3] == pytest.approx(third)
    back = arc_derivatives(found, [lam, lam1, lam2])
    assert back[1] == pytest.approx(found[1] / lam)
    assert back[2] == pytest.approx((found[2] - lam * lam1 * back[1]) / lam**2)


def test_path_speed_is_equation_5():
    slopes = RNG.normal(size=3)
    assert path_speed(list(slopes), 1.4) == pytest.approx(1.4 * np.sqrt((slopes**2).sum()))


def test_both_speed_factors():
    c, span = np.array([0.5, 2.0, 1.0]), 4.0
    bernstein = sum(c[i] * math.comb(2, i) * S**i * (1 - S) ** (2 - i) for i in range(3))
    assert SpeedFactor(c, span)(span * S) == pytest.approx(bernstein)
    factor = TimeFactor(c, span)
    assert factor(span * S) == pytest.approx(span / bernstein)
    assert factor.duration == pytest.approx(c.sum() / 3)


PENDULUM = RotaryPendulum()


def constants(theta: float) -> tuple[float, ...]:
    p, i = PENDULUM, PENDULUM.inertia
    m, r, length = p.mass, p.arm_length, p.com_distance
    a, c = i.z + m * length**2, i.x - i.y + m * length**2
    b = m * length * r * math.cos(theta)
    j = (
        i.disk
        + m * r**2
        + (i.x + m * length**2) * math.sin(theta) ** 2
        + i.y * math.cos(theta) ** 2
    )
    return a, b, c, j, m * p.gravity * length, m * length * r


def test_equations_of_motion_of_the_pendulum():
    theta, psi, q, w = 0.7, 0.3, 5.0, -4.0
    torque = 0.015
    a, b, c, j, mgl, mlr = constants(theta)
    r1 = c / 2 * w**2 * math.sin(2 * theta) + mgl * math.sin(theta)
    r2 = torque - c * q * w * math.sin(2 * theta) + mlr * q**2 * math.sin(theta)
    d = a * j - b**2
    expected = [q, w, (j * r1 - b * r2) / d, (a * r2 - b * r1) / d]
    state = np.array([theta, psi, q, w])
    assert PENDULUM.derivative(state, np.array([torque])) == pytest.approx(expected)
    energy = a * q**2 / 2 + b * q * w + j * w**2 / 2 + mgl * math.cos(theta)
    assert PENDULUM.energy(state) == pytest.approx(energy)
    assert PENDULUM.natural_frequency == pytest.approx(math.sqrt(mgl / a))
    found, theta_ddot = PENDULUM.torque_for(state, np.asarray(expected[3]))
    assert found == pytest.approx(torque)
    assert theta_ddot == pytest.approx((r1 - b * expected[3]) / a)


def test_energy_changes_by_the_work_of_the_torque():
    state, torque, h = np.array([0.7, 0.3, 5.0, -4.0]), np.array([0.015]), 1e-6
    slope = PENDULUM.derivative(state, torque)
    change = PENDULUM.energy(state + h * slope) - PENDULUM.energy(state - h * slope)
    assert change / (2 * h) == pytest.approx(torque[0] * state[3], rel=1e-5)


@pytest.fixture(scope='module')
def swing_up():
    problem = PendulumSwingUp.from_parameters({'limits.torque': 0.09, 'torque_reserve': 0.25})
    return problem.solve(deadline=20.0)


def test_switching_times_are_the_varied_parameters(swing_up):
    plan = swing_up.trajectory
    assert plan.interpolation == 'zero_order_hold'
    assert swing_up.cost == pytest.approx(plan.duration)
    torque = plan.control('torque')[:-1]
    assert np.abs(torque) == pytest.approx(0.75 * 0.09)
    switches = np.count_nonzero(np.diff(np.sign(torque)))
    d = np.asarray(swing_up.parameters).ravel()
    assert d[np.isfinite(d)].min() >= 0.0
    assert 1 <= switches < 8


ROBOT = FloatingRobot()


def test_equations_of_motion_of_a_robot():
    _, _, u, v, yaw, omega, alpha = state = RNG.normal(size=7)
    thrust, rate, torque = 0.5, 0.3, 0.01
    f, t = thrust / ROBOT.mass, torque / ROBOT.inertia
    expected = [u, v, f * math.cos(yaw + alpha), f * math.sin(yaw + alpha), omega, t, rate]
    assert ROBOT.derivative(state, np.array([thrust, rate, torque])) == pytest.approx(expected)


def test_inverse_dynamics_of_a_robot():
    """The formulas of the page, for motions x(s) and a speed factor, against differences."""
    motions = [Polynomial(RNG.normal(size=8)) for _ in range(3)]
    mu = Polynomial([2.0, 0.6, 0.4])
    clock = mu.integ()
    s, h = 0.4, 1e-3

    def arc(t: float) -> float:
        root = s
        for _ in range(50):
            root -= (clock(root) - t) / mu(root)
        return root

    def by_time(motion: Polynomial, order: int) -> float:
        steps = np.arange(-4, 5) * h
        values = [motion(arc(clock(s) + step)) for step in steps]
        return Polynomial.fit(steps, values, 7).convert().deriv(order)(0.0)

    def at(motion: Polynomial) -> tuple[float, float, float]:
        xs, xss, xsss = (motion.deriv(k)(s) for k in (1, 2, 3))
        m, ms, mss = mu(s), mu.deriv(1)(s), mu.deriv(2)(s)
        n = xss * m - xs * ms
        return xs / m, n / m**3, (xsss * m - xs * mss - 3 * n * ms / m) / m**4

    rows = [at(motion) for motion in motions]
    for motion, row in zip(motions, rows, strict=True):
        assert row[0] == pytest.approx(by_time(motion, 1), rel=1e-6)
        assert row[1] == pytest.approx(by_time(motion, 2), rel=1e-5, abs=1e-6)
        assert row[2] == pytest.approx(by_time(motion, 3), rel=1e-3, abs=1e-3)
    (_, ax, jx), (_, ay, jy), (omega, _, _) = rows
    before, after = (
        math.atan2(*(by_time_at(motions[i], arc, clock(s) + step, h) for i in (1, 0)))
        for step in (-h, h)
    )
    heading_rate = math.remainder(after - before, math.tau) / (2 * h)
    delta = (ax * jy - ay * jx) / (ax**2 + ay**2) - omega
    assert delta == pytest.approx(heading_rate - omega, rel=1e-2)


def by_time_at(motion: Polynomial, arc, t: float, h: float) -> float:
    """Second derivative by time at the instant t."""
    return (motion(arc(t + h)) - 2 * motion(arc(t)) + motion(arc(t - h))) / h**2


@pytest.fixture(scope='module')
def formation():
    problem = RobotFormation.from_parameters({'solver.deadline': 20.0})
    return problem, problem.solve()


def test_performance_index_is_equation_28(formation):
    problem, solution = formation
    arrivals = sorted(plan.duration for plan in solution.trajectories.values())
    intervals = np.abs(np.diff(arrivals) - problem.arrival_interval).sum()
    gas = sum(
        trapezoid(plan.control('thrust'), plan.times) for plan in solution.trajectories.values()
    )
    w = problem.weights
    j = w.time * arrivals[0] + w.sequence * intervals + w.gas * gas / problem.plant.mass
    assert solution.cost == pytest.approx(j, rel=5e-3)


def test_penalty_is_equation_29_mended(formation):
    problem, solution = formation
    task = problem.task
    times = np.linspace(0.0, solution.duration, 500)
    plans = [solution.trajectories[name] for name in task.names]
    samples = [plan.sample(np.minimum(times, plan.duration)) for plan in plans]
    states = np.concatenate([sample.state for sample in samples], axis=1)
    controls = np.concatenate([sample.control for sample in samples], axis=1)
    # Violate everything: leave the arena, push too hard, turn too fast, meet the neighbour.
    states[3, 0] = -0.1
    states[5, 8] = task.sides[1] + 0.05
    controls[7, 0] = 1.5 * task.thrust * task.plant.mass
    controls[8, 1] = 2.0 * task.thruster_rate
    controls[9, 5] = -3.0 * task.torque * task.plant.inertia
    states[11, 14:16] = states[11, 7:9] + [0.1, 0.0]
    k = np.array([0.1, 0.2, 0.3, 0.4])
    n, m = task.n, task.separation

    def square(margin: np.ndarray) -> float:
        return float(np.maximum(-margin, 0.0).max() ** 2)

    delta = 0.0
    every = states.reshape(len(states), n, 7)[:, :, :2]
    for i in range(n):
        place = every[:, i]
        f = controls[:, 3 * i] / task.plant.mass / task.thrust
        t = controls[:, 3 * i + 2] / task.plant.inertia / task.torque
        turn = controls[:, 3 * i + 1] / task.thruster_rate
        for q in range(2):
            delta += k[0] * square(place[:, q] - m / 2)
            delta += k[0] * square(task.sides[q] - m / 2 - place[:, q])
        delta += k[1] * square(np.minimum(1 - f, f))
        delta += k[2] * (square(1 - np.abs(t)) + square(1 - np.abs(turn)))
        for other in range(i):
            apart = place - every[:, other]
            delta += k[3] * square(np.hypot(*apart.T) - m)
    assert delta > 0.1
    assert penalty(task, states, controls, k) == pytest.approx(delta, rel=1e-9)


def test_riccati_recursion():
    a, b = np.array([[[0.0, 1.0], [2.0, 0.0]]]), np.array([[[0.0], [1.0]]])
    q, r, h = np.diag([1.0, 0.5]), np.array([[0.1]]), 0.01
    last = np.diag([3.0, 2.0])
    found = time_varying_regulator(a, b, q, r, last, h)
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2:] = a[0] * h, b[0] * h
    step = sum(np.linalg.matrix_power(block, k) / math.factorial(k) for k in range(15))
    ad, bd = step[:2, :2], step[:2, 2:]
    gain = np.linalg.solve(h * r + bd.T @ last @ bd, bd.T @ last @ ad)
    assert found.gains[0] == pytest.approx(gain)
    assert found.costs_to_go[0] == pytest.approx(h * q + ad.T @ last @ (ad - bd @ gain))

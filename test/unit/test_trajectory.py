# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories between their samples, and their replay: every kind of bad plan is caught."""

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest
from replays import by_scipy
from scipy.integrate import quad
from scipy.interpolate import PPoly
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.trajectory import joined, ReplayedMotion, Trajectory
from tdm_planner.verification import _least_between, Constraint, resolved, verify


class DoubleIntegrator:
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)

    def derivative(self, state, control):
        return np.concatenate([state[..., 1:], control], axis=-1)


PLANT = DoubleIntegrator()
TOLERANCE = np.full(2, 1e-6)
GOAL = np.array([1.0, 0.0])
LIMITS = (
    Constraint('thrust', lambda t, x, u: 1 - np.abs(u[:, 0]), tolerance=1e-12),
    Constraint('speed', lambda t, x, u: 1.0001 - np.abs(x[:, 1])),
)


def make(times=(0.0, 1.0, 3.0), interpolation='zero_order_hold', controls=(1.0, -1.0, 0.0)):
    times, u = np.array(times), np.array(controls)
    states = np.zeros((times.size, 2))
    for k in range(times.size - 1):
        h = times[k + 1] - times[k]
        x, v = states[k]
        states[k + 1] = x + v * h + u[k] * h**2 / 2, v + u[k] * h
    return Trajectory.of(PLANT, times, states, u[:, None], interpolation)


def test_between_samples_states_are_exact_for_a_double_integrator_and_controls_interpolated():
    trajectory = make().with_rates(PLANT.derivative)
    t = np.linspace(0, 1, 9)
    np.testing.assert_allclose(trajectory.sample(t).state[:, 0], t**2 / 2, atol=1e-15)
    np.testing.assert_allclose(trajectory.sample(2.0).state, [1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(trajectory.rates[0, 1], [1.0, 1.0])
    np.testing.assert_allclose(trajectory.rates[1, 0], [1.0, -1.0])
    times = np.linspace(0, 2, 9)
    for kind, power, found in (('linear', 1, 0.3), ('cubic', 3, 0.027)):
        control = make(times, kind, times**power).sample(0.3).control[0]
        assert control == pytest.approx(found)


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
    with pytest.raises(ValueError, match='read-only'):
        make().times[0] = 5.0
    with pytest.raises(InvalidProblem, match="no state 'speed': it has x, v"):
        make().state('speed')
    with pytest.raises(InvalidProblem, match='a pair of 2 rates for each of 2 intervals'):
        replace(make(), rates=np.zeros((2, 1, 2)))
    unknown = make().with_rates(lambda x, u: np.nan * x)  # as where a formula has no value
    with pytest.raises(InvalidProblem, match="'rates' holds a value that is not finite"):
        Trajectory.from_dict(unknown.to_dict())
    with pytest.raises(InvalidProblem, match="no control 'uu': did you mean u"):
        make().control('uu')


@pytest.mark.parametrize('interpolation', ['zero_order_hold', 'linear', 'cubic'])
def test_the_integral_of_the_controls_is_exact(monkeypatch, interpolation):
    antiderivative = PPoly.antiderivative

    def of_old(self, nu=1):
        """Before 1.15 SciPy raises "buffer source array is read-only"."""
        assert self.x.flags.writeable
        return antiderivative(self, nu)

    monkeypatch.setattr(PPoly, 'antiderivative', of_old)
    times = np.cumsum([0.0, 0.11, 0.07, 0.2, 0.05])
    trajectory = make(times, interpolation, [1.0, -2.0, 0.5, 3.0, 0.0])
    edges = zip(times[:-1], times[1:] - 1e-15, strict=True)
    pieces = [quad(lambda t: float(trajectory.sample(t).control[0]), *both)[0] for both in edges]
    integral = trajectory.control_integral(times)[:, 0]
    np.testing.assert_allclose(integral, np.cumsum([0.0, *pieces]), atol=1e-12)
    outside = trajectory.control_integral([-1.0, times[-1] + 1.0])[:, 0]
    np.testing.assert_array_equal(outside, integral[[0, -1]])


def verified(plant, plan, *given, **more):
    return verify(plant, plan, by_scipy(plant, plan), *given, **more)


BANG_BANG = make((0.0, 1.0, 2.0))  # minimum time over 1 m with |u| <= 1


def test_a_good_plan_passes_and_margins_are_reported():
    check = verified(PLANT, BANG_BANG, GOAL, TOLERANCE, LIMITS)
    assert check.ok, check.reasons
    assert (check.worst['thrust'], check.worst['speed']) == (pytest.approx(0), pytest.approx(1e-4))
    assert check.worst_times['speed'] == pytest.approx(1.0, abs=2e-3)
    assert check.to_dict()['terminal_error'].keys() == {'x', 'v'}
    free = verified(PLANT, BANG_BANG, np.add(GOAL, [3.0, 0.0]), TOLERANCE * [np.inf, 1.0], LIMITS)
    assert free.ok, free.reasons
    assert free.terminal_error == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'times': np.array([0.0, 1.001, 2.001])}, 'from the goal'),
        ({'controls': np.array([[1.01], [-1.01], [0.0]])}, 'thrust is violated by 0.01'),
        ({'states': np.array([[0.0, 0.0], [0.5, 1.1], [1.0, 0.0]])}, 'differs by 0.1'),
        ({'states': np.array([[0.1, 0.0], [0.5, 1.0], [1.0, 0.0]])}, 'from the goal'),
    ],
)
def test_every_kind_of_bad_plan_is_caught(changes, words):
    check = verified(PLANT, replace(BANG_BANG, **changes), GOAL, TOLERANCE, LIMITS)
    assert not check.ok
    assert any(words in reason for reason in check.reasons), check.reasons


def test_a_motion_whose_replay_breaks_off_is_said_to_be_too_fast():
    broken = ReplayedMotion(BANG_BANG.times, lambda t: np.full((t.size, 2), np.nan))
    check = verify(PLANT, BANG_BANG, broken, GOAL, TOLERANCE, LIMITS)
    assert (check.ok, check.reasons) == (False, ('its motion is too fast to be replayed',))


@pytest.mark.parametrize(
    ('states', 'words'),
    [
        ([[0.1, 0.0], [0.6, 1.0], [1.1, 0.0]], 'x begins 0.1 m from the start (allowed 0.0'),
        ([[0.0, 0.0], [0.7, 1.0], [1.0, 0.0]], 'x as written differs by 0.2 from the replay'),
    ],
)
@pytest.mark.parametrize('allowed', [np.inf, 10.0])
def test_a_state_whose_end_is_free_or_wide_is_checked_before(states, words, allowed):
    free = np.array([allowed, 1e-6])
    start = np.zeros(2)
    reached = verified(PLANT, BANG_BANG, np.ones(2), free, LIMITS[:1], start=start)
    assert reached.reasons == ('v ends 1 m/s from the goal (allowed 1e-06)',)
    changed = replace(BANG_BANG, states=np.array(states))
    check = verified(PLANT, changed, GOAL, free, LIMITS, start=start)
    assert len(check.reasons) == 1
    assert words in check.reasons[0]


class Swing(DoubleIntegrator):
    """A pendulum of 1 Hz that nobody drives."""

    def derivative(self, state, control):
        return np.stack([state[..., 1], -(math.tau**2) * state[..., 0]], axis=-1)


def test_motion_that_is_fast_beside_the_samples_is_followed():
    """Wherever samples, and instants that divide the way between them, fall: x is zero there."""
    start, u = np.array([0.0, math.tau]), np.zeros((3, 1))
    still = Trajectory.of(PLANT, np.array([0.0, 10.0, 20.0]), np.tile(start, (3, 1)), u)
    near = Constraint('near', lambda t, x, u: 0.999 - np.abs(x[:, 0]))
    check = verified(Swing(), still, start, TOLERANCE, [near])
    assert check.worst['near'] == pytest.approx(-1e-3, abs=1e-4)


@pytest.mark.parametrize('place', [0.1, 0.5, 0.7371])
def test_a_dip_of_a_margin_between_the_instants_of_a_check_is_found(place):
    pole = Constraint('pole', lambda t, x, u: np.abs(x[:, 0] - place) - 1e-5)
    check = verified(PLANT, BANG_BANG, GOAL, TOLERANCE, [pole])
    assert 'pole is violated' in check.reasons[0]


@pytest.mark.parametrize('steps', [1_000, 60_000])
def test_a_peak_between_the_instants_is_found_however_long_the_motion(steps):
    peaks = lambda t: np.sin(2 * np.pi * (t - 0.07) / 8)  # noqa: E731
    flight = SimpleNamespace(steps=np.arange(steps + 1.0), states=lambda t: peaks(t)[:, None])
    ends = SimpleNamespace(times=np.array([0.0, steps]), controls_at=lambda t: t[:, None])
    limit = peaks(np.linspace(0.0, 8.0, 41)).max() + 1e-5  # kept at every fifth of a step
    _, states = resolved(flight, ends, [Constraint('x', lambda t, x, u: limit - x[:, 0])])
    assert states.max() > limit + 1e-3


@pytest.mark.parametrize('turned', [1, -1])
def test_a_dip_in_the_first_and_in_the_last_interval_is_reckoned_with(turned):
    """One of its slopes is unknown there."""
    times = np.linspace(0.0, 15.0, 4)
    margin = (times - 13.0)[::turned] ** 2
    assert _least_between(times, margin)[::turned][-1] <= 0.0


@pytest.mark.parametrize('turned', [1, -1])
@pytest.mark.parametrize('edge', [0.31, 0.5, 0.7371])
def test_a_margin_that_jumps_below_what_is_allowed_between_two_instants_is_violated(edge, turned):
    """A limit of speed where a region begins, kept again soon after: no instant shows it."""
    rises = lambda t: turned * (t - edge)  # noqa: E731

    def margin(t, x, u):
        return np.where(rises(t) > 0.0, rises(t) - 0.002, 0.5)

    check = verified(PLANT, BANG_BANG, GOAL, TOLERANCE, [Constraint('zone', margin)])
    assert 'zone is violated' in check.reasons[0]


def test_a_margin_that_is_just_kept_is_no_violation_but_one_that_is_not_a_number_is():
    touched = Constraint('touched', lambda t, x, u: (x[:, 0] - 0.7371) ** 2, tolerance=1e-12)
    check = verified(PLANT, BANG_BANG, GOAL, TOLERANCE, [touched])
    assert check.ok
    assert 0.0 <= check.worst['touched'] < 1e-9
    broken = Constraint('broken', lambda t, x, u: np.where(t > 1.5, np.nan, 1.0))
    assert not verified(PLANT, BANG_BANG, GOAL, TOLERANCE, [broken]).ok


def test_where_controls_jump():
    constant = replace(BANG_BANG, controls=np.ones((3, 1)))
    for plan, switches, pieces in (
        (BANG_BANG, [1], [0, 1, 2]),
        (constant, [], [0, 2]),
        (replace(BANG_BANG, interpolation='linear'), [], [0, 1, 2]),
        (replace(BANG_BANG, interpolation='cubic'), [], [0, 1, 2]),
    ):
        assert (plan.switches.tolist(), [*plan.control_pieces.x]) == (switches, pieces)


@pytest.mark.parametrize('first', ['zero_order_hold', 'linear'])
@pytest.mark.parametrize('last', ['zero_order_hold', 'linear'])
def test_a_vehicle_that_has_arrived_is_driven_no_more(first, last):
    parts = {
        'early': make((0.0, 1.0, 2.5), first, (1.0, -1.0, 0.5)),
        'late': make((0.0, 1.5, 3.0, 4.0), last, (1.0, -1.0, 0.5, 0.25)),
    }
    whole = joined(parts)
    assert whole.duration == 4.0
    for name, part in parts.items():
        then = np.array([0.7, 2.0, part.duration - 1e-6, 4.0])
        column = whole.control_names.index(f'{name}.u')
        driven = whole.control_integral(then)[:, column]
        # A jump between linear pieces takes 1 ns.
        np.testing.assert_allclose(driven, part.control_integral(then)[:, 0], atol=1e-9)
        np.testing.assert_array_equal(whole.states[-1].reshape(2, 2)[column], part.states[-1])


def test_joined_trajectories_keep_instants_that_are_no_whole_nanoseconds():
    early = make((0.0, 1.0 / 7.0, 1.0 / 3.0 + 4e-10, np.pi), 'linear', (1.0, -1.0, 0.5, 0.25))
    late = make((0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0), 'linear', (1.0, -1.0, 0.5, 0.25))
    assert joined({'early': early, 'late': late}).duration == np.pi

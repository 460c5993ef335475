# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The replay against closed forms, and every kind of bad plan caught."""

from dataclasses import replace
import math

import numpy as np
import pytest
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import Constraint, dense_times, replay, verify


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


def bang_bang():
    """Minimum time over 1 m with |u| <= 1: the closed form, sampled at the switch and the ends."""
    return Trajectory(
        np.array([0.0, 1.0, 2.0]),
        np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 0.0]]),
        np.array([[1.0], [-1.0], [0.0]]),
        PLANT.state_names,
        PLANT.control_names,
    )


def test_replay_of_held_controls_follows_the_closed_form():
    t = np.linspace(0, 2, 41)
    states = replay(PLANT, bang_bang(), t)
    expected = np.where(t <= 1, t**2 / 2, 1 - (2 - t) ** 2 / 2)
    np.testing.assert_allclose(states[:, 0], expected, atol=1e-10)


@pytest.mark.parametrize(('interpolation', 'power'), [('linear', 1), ('cubic', 3)])
def test_replay_of_interpolated_controls_follows_the_closed_form(interpolation, power):
    t = np.linspace(0, 2, 6)
    n = power
    states = np.stack([t ** (n + 2) / ((n + 1) * (n + 2)), t ** (n + 1) / (n + 1)], axis=-1)
    trajectory = Trajectory(t, states, t[:, None] ** n, ('x', 'v'), ('u',), interpolation)
    np.testing.assert_allclose(replay(PLANT, trajectory, t), states, atol=1e-9)


def test_a_good_plan_passes_and_margins_are_reported():
    check = verify(PLANT, bang_bang(), GOAL, TOLERANCE, LIMITS)
    assert check.ok, check.reasons
    assert check.worst['thrust'] == pytest.approx(0)
    assert check.worst['speed'] == pytest.approx(1e-4)
    assert check.worst_times['speed'] == pytest.approx(1.0, abs=2e-3)
    assert check.to_dict()['terminal_error'].keys() == {'x', 'v'}


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
    check = verify(PLANT, replace(bang_bang(), **changes), GOAL, TOLERANCE, LIMITS)
    assert not check.ok
    assert any(words in reason for reason in check.reasons), check.reasons


@pytest.mark.parametrize(
    ('states', 'words'),
    [
        ([[0.1, 0.0], [0.6, 1.0], [1.1, 0.0]], 'x begins 0.1 m from the start (allowed 0.0'),
        ([[0.0, 0.0], [0.7, 1.0], [1.0, 0.0]], 'x as written differs by 0.2 from the replay'),
    ],
)
def test_a_state_whose_end_is_free_is_checked_before(states, words):
    free = np.array([np.inf, 1e-6])
    start = np.zeros(2)
    assert verify(PLANT, bang_bang(), np.ones(2), free, LIMITS[:1], start=start).reasons == (
        'v ends 1 m/s from the goal (allowed 1e-06)',
    )
    changed = replace(bang_bang(), states=np.array(states))
    check = verify(PLANT, changed, GOAL, free, LIMITS, start=start)
    assert len(check.reasons) == 1
    assert words in check.reasons[0]


def test_a_violation_between_samples_is_caught():
    """Nothing is wrong at the samples: only the dense check sees the speed in between."""
    slow = Constraint('speed', lambda t, x, u: 0.9 - np.abs(x[:, 1]))
    check = verify(PLANT, bang_bang(), GOAL, TOLERANCE, [slow])
    assert not check.ok
    assert 'speed is violated' in check.reasons[0]


class Swing(DoubleIntegrator):
    """A pendulum of 1 Hz that nobody drives."""

    def derivative(self, state, control):
        return np.stack([state[..., 1], -(math.tau**2) * state[..., 0]], axis=-1)


def test_motion_that_is_fast_beside_the_samples_is_followed():
    """Wherever samples, and instants that divide the way between them, fall: x is zero there."""
    start = np.array([0.0, math.tau])
    times = np.array([0.0, 10.0, 20.0])
    still = Trajectory(times, np.tile(start, (3, 1)), np.zeros((3, 1)), ('x', 'v'), ('u',))
    near = Constraint('near', lambda t, x, u: 0.999 - np.abs(x[:, 0]))
    check = verify(Swing(), still, start, TOLERANCE, [near])
    assert check.worst['near'] == pytest.approx(-1e-3, abs=1e-4)


@pytest.mark.parametrize('place', [0.1, 0.5, 0.7371])
def test_a_dip_of_a_margin_between_the_instants_of_a_check_is_found(place):
    pole = Constraint('pole', lambda t, x, u: np.abs(x[:, 0] - place) - 1e-5)
    check = verify(PLANT, bang_bang(), GOAL, TOLERANCE, [pole])
    assert 'pole is violated' in check.reasons[0]


def test_a_margin_that_is_just_kept_is_no_violation():
    touched = Constraint('touched', lambda t, x, u: (x[:, 0] - 0.7371) ** 2, tolerance=1e-12)
    check = verify(PLANT, bang_bang(), GOAL, TOLERANCE, [touched])
    assert check.ok
    assert 0.0 <= check.worst['touched'] < 1e-9


def test_a_margin_that_is_not_a_number_counts_as_violated():
    broken = Constraint('broken', lambda t, x, u: np.where(t > 1.5, np.nan, 1.0))
    check = verify(PLANT, bang_bang(), GOAL, TOLERANCE, [broken])
    assert not check.ok


def test_dense_times_hold_every_sample():
    times = dense_times(bang_bang(), 0.3)
    assert np.isin([0.0, 1.0, 2.0], times).all()
    assert np.diff(times).max() <= 0.3

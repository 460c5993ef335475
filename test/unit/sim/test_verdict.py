# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Was the swing-up reached and held?"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
import pytest
from tdm_planner.trajectory import Trajectory
from tdm_sim.verdict import held_from, judge_pendulum, MeasuredPendulum, Verdict

Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
PLAN = Trajectory(
    np.array([0.0, 1.0]),
    np.array([[math.pi, 0, 0, 0], [2 * math.pi, 0.5, 0, 0]]),
    np.array([[0.014], [-0.014]]),
    ('theta', 'psi', 'theta_dot', 'psi_dot'),
    ('torque',),
)


def judge(end: float = 7.0, **changes: Change) -> Verdict:
    """Judge a swing-up in a second, measured until `end`; `changes` spoil what was measured."""
    times = np.arange(0, end, 0.005)
    columns = {
        'theta': math.pi + math.pi * np.clip(times, 0, 1),
        'psi': np.full_like(times, 0.1),
        'theta_dot': np.zeros_like(times),
        'psi_dot': np.zeros_like(times),
        'torque': np.full_like(times, 0.01),
    }
    columns |= {name: change(times, columns[name]) for name, change in changes.items()}
    return judge_pendulum(PLAN, MeasuredPendulum(times, **columns), 0.02, 2.0, 0.1)


def test_a_swing_up_that_is_held_passes() -> None:
    verdict = judge()
    assert verdict.reached, verdict.reasons
    rows = {name: (planned, achieved) for name, planned, achieved in verdict.rows}
    assert rows['duration of the plan [s]'] == ('1.000', '')
    planned, achieved = map(float, rows['upright within 0.05 rad from [s]'])
    assert achieved == pytest.approx(1 - 0.05 / math.pi, abs=0.005)
    assert planned == pytest.approx(achieved, abs=0.005)  # judged alike
    assert rows['torque margin [N m]'] == ('0.0060', '0.0100')
    assert rows['disk angle margin [rad]'] == ('1.500', '1.900')
    assert rows['held for [s]'] == ('>= 5', '6.0')


@pytest.mark.parametrize(
    ('name', 'change', 'words'),
    [
        ('theta', lambda t, x: np.where(t > 3, x + 0.06, x), 'not upright'),
        ('theta', lambda t, x: np.where(t > 6.99, x + 0.06, x), 'not upright'),
        ('theta', lambda t, x: 0 * x + math.pi * 0.9, 'not upright'),
        ('psi', lambda t, x: np.where(abs(t - 0.5) < 0.01, -2.01, x), 'disk'),
        ('torque', lambda t, x: np.where(abs(t - 0.5) < 0.01, -0.021, x), 'torque'),
        ('theta', lambda t, x: np.where(t > 3, np.nan, x), 'not upright'),
    ],
)
def test_each_way_to_miss_is_named(name: str, change: Change, words: str) -> None:
    verdict = judge(**{name: change})
    assert not verdict.reached
    assert words in verdict.reasons[0]


@pytest.mark.parametrize('end', [0.5, 1.0, 3.9, 5.9])
def test_measurements_that_end_before_the_hold_time_has_passed_decide_nothing(end: float) -> None:
    verdict = judge(end)
    assert (verdict.reasons, verdict.reached) == ((), False)
    assert verdict.undecided.startswith(f'the recording ends at {end:.1f} s, before')
    missed = judge(end, torque=lambda t, x: 0 * x + 0.021)
    assert (len(missed.reasons), missed.undecided) == (1, '')


def test_a_late_catch_is_undecided_until_it_has_been_held() -> None:
    verdict = judge(theta=lambda t, x: np.where(abs(t - 3) < 0.01, x - 0.06, x))
    assert (verdict.reasons, verdict.reached) == ((), False)
    assert verdict.undecided.startswith('the recording ends at 7.0 s')


def test_held_from_the_last_time_outside() -> None:
    times = np.arange(5.0)
    assert held_from(times, np.array([1, 0, 1, 0, 0.0]), 0.5) == 3.0
    assert held_from(times, np.array([0, 0, 0, 0, 1.0]), 0.5) == math.inf
    assert held_from(times, np.zeros(5), 0.5) == 0.0

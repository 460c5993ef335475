# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import math

import numpy as np
import pytest
from tdm_planner.trajectory import Trajectory
from tdm_sim.verdict import held_from, judge_pendulum, MeasuredPendulum

PLAN = Trajectory(
    np.array([0.0, 1.0]),
    np.array([[math.pi, 0, 0, 0], [2 * math.pi, 0.5, 0, 0]]),
    np.array([[0.014], [-0.014]]),
    ('theta', 'psi', 'theta_dot', 'psi_dot'),
    ('torque',),
)


def measured(**changes):
    times = np.arange(0, 7, 0.005)
    swing = np.clip(times, 0, 1)
    columns = {
        'theta': math.pi + math.pi * swing,
        'psi': 0.1 * np.ones_like(times),
        'theta_dot': np.zeros_like(times),
        'psi_dot': np.zeros_like(times),
        'torque': 0.01 * np.ones_like(times),
    }
    columns.update({name: change(times, columns[name]) for name, change in changes.items()})
    return MeasuredPendulum(times, **columns)


def judge(**changes):
    return judge_pendulum(PLAN, measured(**changes), 0.02, 2.0, 0.1)


def test_a_swing_up_that_is_held_passes():
    verdict = judge()
    assert verdict.reached, verdict.reasons
    rows = {name: (planned, achieved) for name, planned, achieved in verdict.rows}
    assert rows['duration of the plan [s]'] == ('1.000', '')
    planned, achieved = map(float, rows['upright within 0.05 rad from [s]'])
    assert achieved == pytest.approx(1 - 0.05 / math.pi, abs=0.005)
    assert planned == pytest.approx(achieved, abs=0.005)  # judged alike
    assert 'held for [s]' in rows


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'theta': lambda t, x: np.where(t > 3, x + 0.06, x)}, 'not upright'),
        ({'theta': lambda t, x: np.where(t > 6.99, x + 0.06, x)}, 'not upright'),
        ({'theta': lambda t, x: 0 * x + math.pi * 0.9}, 'not upright'),
        ({'psi': lambda t, x: np.where(abs(t - 0.5) < 0.01, -2.01, x)}, 'disk'),
        ({'torque': lambda t, x: np.where(abs(t - 0.5) < 0.01, -0.021, x)}, 'torque'),
        ({'theta': lambda t, x: np.where(t > 3, np.nan, x)}, 'not upright'),
    ],
)
def test_each_way_to_miss_is_named(changes, words):
    verdict = judge(**changes)
    assert not verdict.reached
    assert words in verdict.reasons[0]


@pytest.mark.parametrize('end', [0.5, 1.0, 1.5, 3.9, 5.9])
def test_measurements_that_end_before_the_hold_time_has_passed_decide_nothing(end):
    whole = measured()
    kept = {name: value[whole.times < end] for name, value in vars(whole).items()}
    verdict = judge_pendulum(PLAN, MeasuredPendulum(**kept), 0.02, 2.0, 0.1)
    assert verdict.reasons == ()
    assert not verdict.reached
    assert verdict.undecided.startswith(f'the recording ends at {end:.1f} s, before')
    kept['torque'] = 0 * kept['torque'] + 0.021
    missed = judge_pendulum(PLAN, MeasuredPendulum(**kept), 0.02, 2.0, 0.1)
    assert (len(missed.reasons), missed.undecided) == (1, '')


def test_a_late_catch_is_undecided_until_it_has_been_held():
    verdict = judge(theta=lambda t, x: np.where(abs(t - 3) < 0.01, x - 0.06, x))
    assert (verdict.reasons, verdict.reached) == ((), False)
    assert verdict.undecided.startswith('the recording ends at 7.0 s')


def test_held_from_the_last_time_outside():
    times = np.arange(5.0)
    assert held_from(times, np.array([1, 0, 1, 0, 0.0]), 0.5) == 3.0
    assert held_from(times, np.array([0, 0, 0, 0, 1.0]), 0.5) == math.inf
    assert held_from(times, np.zeros(5), 0.5) == 0.0

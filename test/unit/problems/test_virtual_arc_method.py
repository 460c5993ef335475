# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Method `virtual_arc` from request to verified plan: monotone transfers, reasons elsewhere."""

from __future__ import annotations

import itertools
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, TdmError
from tdm_planner.problems import PendulumGoal, PendulumLimits, PendulumStart, PendulumSwingUp

ENOUGH = 20.0  # [s], so that the deadline never decides on a busy machine


def problem(start: PendulumStart, torque: float = 0.09, **others) -> PendulumSwingUp:
    given: dict[str, Any] = {'torque_reserve': 0.0, 'method': 'virtual_arc'} | others
    return PendulumSwingUp(limits=PendulumLimits(torque=torque), start=start, **given)


def replayed_end(made: PendulumSwingUp, trajectory) -> np.ndarray:
    """Integrate what is written, switch by switch, with an implicit method."""
    state = trajectory.states[0]
    jumps = np.flatnonzero(np.diff(trajectory.controls[:-1, 0])) + 1
    for first, last in itertools.pairwise([0, *jumps, trajectory.times.size - 1]):
        held = trajectory.controls[first]
        state = solve_ivp(
            lambda t, x, u=held: made.plant.derivative(x, u),
            trajectory.times[[first, last]],
            state,
            'Radau',
            rtol=1e-10,
            atol=1e-11,
        ).y[:, -1]
    return state


def check(made: PendulumSwingUp, solution) -> None:
    trajectory = solution.trajectory
    assert solution.verification.ok
    end = replayed_end(made, trajectory)
    turns = round(end[0] / (2 * np.pi))
    assert (np.abs(end - [2 * np.pi * turns, 0, 0, 0]) <= [1e-4, 1e-4, 1e-3, 1e-3]).all()
    way = np.sign(trajectory.states[-1, 0] - trajectory.states[0, 0])
    assert (way * np.diff(trajectory.state('theta')) > -1e-6).all()
    assert np.abs(trajectory.controls).max() <= made.limits.torque
    assert np.abs(trajectory.state('psi')).max() <= made.limits.disk_angle


@pytest.mark.parametrize(
    ('theta', 'torque'), [(0.4, 0.063), (-0.4, 0.063), (0.8, 0.09), (1.5, 0.09), (-1.2, 0.04)]
)
def test_from_rest_as_quick_as_switching_where_it_goes_one_way(theta, torque):
    made = problem(PendulumStart(theta=theta), torque)
    solution = made.solve(ENOUGH)
    check(made, solution)
    # From here upright is reached without swinging back only once round.
    assert round(solution.trajectory.states[-1, 0] / (2 * np.pi)) == np.sign(theta)
    quickest = problem(PendulumStart(theta=theta), torque, method='switching').solve(ENOUGH)
    assert quickest.cost * (1 - 1e-3) < solution.cost < 1.03 * quickest.cost


@given(
    theta=st.floats(-3.0, 3.0),
    psi=st.floats(-0.5, 0.5),
    speed=st.floats(0.0, 8.0),
    way=st.sampled_from([-1.0, 1.0]),
    psi_dot=st.floats(-3.0, 3.0),
)
@settings(deadline=None, derandomize=True, max_examples=10)
def test_any_plan_lands_and_any_failure_has_a_reason(theta, psi, speed, way, psi_dot):
    made = problem(PendulumStart(theta=theta, psi=psi, theta_dot=way * speed, psi_dot=psi_dot))
    try:
        solution = made.solve(3.0)
    except Infeasible as error:
        assert 'switching' in str(error) or 'passes the check' in str(error)
        return
    check(made, solution)


@pytest.mark.parametrize('seed', range(3))
def test_moving_either_way(seed):
    left, right = (
        problem(PendulumStart(theta=sign * 2.0, theta_dot=sign * 5.0)) for sign in (1, -1)
    )
    solutions = [made.solve(ENOUGH, seed=seed) for made in (left, right)]
    for made, solution in zip((left, right), solutions, strict=True):
        check(made, solution)
    assert solutions[0].cost == pytest.approx(solutions[1].cost, rel=0.1)


def test_the_same_seed_gives_the_same_plan():
    made = problem(PendulumStart(theta=0.4))
    first, second = made.solve(ENOUGH, seed=4), made.solve(ENOUGH, seed=4)
    np.testing.assert_array_equal(first.trajectory.times, second.trajectory.times)


def test_weak_torque_from_hanging_is_infeasible_with_a_reason():
    with pytest.raises(Infeasible, match=r"one way all along.*method 'switching'") as error:
        problem(PendulumStart(), 0.02).solve(ENOUGH)
    assert error.value.code == 'INFEASIBLE'


def test_moving_away_from_the_goal_is_said_at_once():
    made = problem(PendulumStart(theta=2.0, theta_dot=1.0), goal=PendulumGoal(turns=0))
    with pytest.raises(Infeasible, match=r'theta_dot = 1 rad/s away from goal.turns = 0'):
        made.solve(ENOUGH)


def test_no_time_is_a_deadline():
    with pytest.raises(DeadlineExceeded, match='in 1e-06 s'):
        problem(PendulumStart(theta=0.4)).solve(1e-6)


def test_a_narrow_disk_angle_is_kept_or_refused():
    made = PendulumSwingUp(
        limits=PendulumLimits(torque=0.09, disk_angle=0.8),
        torque_reserve=0.0,
        start=PendulumStart(theta=0.8),
        method='virtual_arc',
    )
    try:
        solution = made.solve(ENOUGH)
    except TdmError as error:
        assert isinstance(error, Infeasible)
    else:
        check(made, solution)


def test_upright_already_is_done_already():
    solution = problem(PendulumStart(theta=0.0)).solve(ENOUGH)
    assert solution.duration < 0.01

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The swing-up from request to verified plan: any state, limits, errors, determinism."""

from __future__ import annotations

import dataclasses
import itertools

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.plants import PendulumInertia, RotaryPendulum
from tdm_planner.problems import (
    PendulumGoal,
    PendulumLimits,
    PendulumStart,
    PendulumSwingUp,
    Solution,
)

ENOUGH = 20.0  # [s], so that the deadline never decides on a busy machine
STATES = st.builds(
    PendulumStart,
    theta=st.floats(-np.pi, np.pi),
    psi=st.floats(-1.9, 1.9),
    theta_dot=st.floats(-10.0, 10.0),
    psi_dot=st.floats(-10.0, 10.0),
)
HANGING = PendulumStart()


def problem(torque: float = 0.09, start: PendulumStart = HANGING, **others) -> PendulumSwingUp:
    others.setdefault('torque_reserve', 0.0)
    return PendulumSwingUp(limits=PendulumLimits(torque=torque), start=start, **others)


def replay_end(made: PendulumSwingUp, solution: Solution) -> np.ndarray:
    """Integrate what is written, switch by switch, without the package's own verification."""
    trajectory = solution.trajectory
    state = trajectory.states[0]
    switches = np.flatnonzero(np.diff(trajectory.controls[:-1, 0])) + 1
    for first, last in itertools.pairwise([0, *switches, trajectory.times.size - 1]):
        held = trajectory.controls[first]
        state = solve_ivp(
            lambda t, x, u=held: made.plant.derivative(x, u),
            (trajectory.times[first], trajectory.times[last]),
            state,
            method='Radau' if last - first < 2 else 'DOP853',
            rtol=1e-10,
            atol=1e-11,
        ).y[:, -1]
    return state


def assert_upright(state: np.ndarray) -> None:
    error = state - [2 * np.pi * np.round(state[0] / (2 * np.pi)), 0.0, 0.0, 0.0]
    assert (np.abs(error) <= [1e-4, 1e-4, 1e-3, 1e-3]).all()


@pytest.mark.parametrize(('torque', 'longest'), [(0.09, 0.387), (0.02, 1.06)])
def test_quick_from_hanging(torque, longest):
    made = problem(torque)
    solution = made.solve(ENOUGH)
    assert solution.verification.ok
    assert solution.cost == solution.trajectory.duration <= longest
    assert_upright(replay_end(made, solution))


@pytest.mark.parametrize('torque', [0.09, 0.02])
@given(start=STATES)
@settings(deadline=None, derandomize=True, max_examples=20)
def test_any_state_gets_a_verified_plan(torque, start):
    made = problem(torque, start)
    if made.task.braking_peak() > made.limits.disk_angle:
        with pytest.raises(Infeasible, match='even braked fully'):
            made.solve(0.2)
        return
    solution = made.solve(ENOUGH)
    trajectory = solution.trajectory
    np.testing.assert_array_equal(
        trajectory.states[0], [start.theta, start.psi, start.theta_dot, start.psi_dot]
    )
    assert np.abs(trajectory.controls).max() <= torque
    assert np.abs(trajectory.state('psi')).max() <= made.limits.disk_angle
    assert_upright(replay_end(made, solution))


def test_samples_are_what_messages_can_carry():
    solution = problem(0.02).solve(ENOUGH)
    times = solution.trajectory.times
    np.testing.assert_allclose(times * 1e9, np.round(times * 1e9), rtol=0, atol=1e-3)
    assert times[0] == 0.0
    assert np.diff(times).max() <= 5.0e-3 + 1e-9
    torque = solution.trajectory.control('torque')
    assert set(np.abs(torque)) == {0.02}
    switches = times[:-1][np.flatnonzero(np.diff(torque[:-1])) + 1]
    np.testing.assert_allclose(switches, np.cumsum(solution.parameters)[:-1], atol=2e-9)
    assert solution.trajectory.rates is not None
    assert solution.trajectory.state_units == ('rad', 'rad', 'rad/s', 'rad/s')
    assert solution.trajectory.control_units == ('N m',)
    assert solution.evaluations > 0
    assert 0 <= solution.penalty <= made_tolerance()
    assert '2 pi' in solution.summary


def made_tolerance() -> float:
    return PendulumSwingUp().solver.tolerance


def test_the_reserve_is_left_to_the_feedback():
    solution = problem(0.09, torque_reserve=0.2).solve(ENOUGH)
    assert np.abs(solution.trajectory.controls).max() == pytest.approx(0.072)
    assert solution.verification.worst['torque'] == pytest.approx(0.018)
    assert solution.cost > problem(0.09).solve(ENOUGH).cost


@pytest.mark.parametrize('disk_angle', [0.7, 0.55])
def test_a_narrow_disk_is_respected(disk_angle):
    limits = PendulumLimits(torque=0.09, disk_angle=disk_angle)
    made = PendulumSwingUp(limits=limits, torque_reserve=0.0)
    solution = made.solve(ENOUGH)
    assert solution.verification.worst['disk_angle'] >= 0.0
    assert np.abs(solution.trajectory.state('psi')).max() <= disk_angle
    assert_upright(replay_end(made, solution))
    assert solution.cost > problem(0.09).solve(ENOUGH).cost


@pytest.mark.parametrize('turns', [0, 1, -1])
def test_the_goal_asked_for_is_reached(turns):
    solution = problem(0.09, goal=PendulumGoal(turns=turns)).solve(ENOUGH)
    assert solution.trajectory.states[-1, 0] == pytest.approx(2 * np.pi * turns, abs=1e-4)


def test_fastest_goal_is_no_slower_than_a_given_one():
    start = PendulumStart(theta=2.0, theta_dot=3.0)
    free = problem(0.09, start).solve(ENOUGH)
    given_goal = problem(0.09, start, goal=PendulumGoal(turns=0)).solve(ENOUGH)
    assert free.cost <= 1.02 * given_goal.cost


def test_mirror_images_take_the_same_time():
    start = PendulumStart(theta=2.5, psi=0.3, theta_dot=-1.0, psi_dot=2.0)
    mirrored = PendulumStart(theta=-2.5, psi=-0.3, theta_dot=1.0, psi_dot=-2.0)
    times = [problem(0.09, s).solve(ENOUGH).cost for s in (start, mirrored)]
    assert times[0] == pytest.approx(times[1], rel=0.02)


@pytest.mark.parametrize('method', ['switching', 'smooth'])
def test_at_the_goal_nothing_needs_to_be_done(method):
    solution = problem(start=PendulumStart(theta=0.0), method=method).solve(ENOUGH)
    assert solution.verification.ok
    assert solution.trajectory.times.size >= 2
    assert not solution.trajectory.controls.any()


def test_near_the_goal_the_plan_is_short():
    made = problem(start=PendulumStart(theta=1e-3, psi=1e-3))
    solution = made.solve(ENOUGH)
    assert solution.cost < 0.1
    assert_upright(replay_end(made, solution))


def test_the_same_seed_gives_the_same_plan():
    first, second = (problem(0.02).solve(ENOUGH, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.parameters, second.parameters)
    np.testing.assert_array_equal(first.trajectory.states, second.trajectory.states)


def test_an_earlier_plan_is_a_start():
    # One random start hardly ever arrives; the earlier plan next to it does.
    before = problem(0.02).solve(ENOUGH)
    moved = problem(0.02, PendulumStart(theta=np.pi - 0.02, psi=0.01))
    after = moved.solve(ENOUGH, warm_start=before)
    assert after.verification.ok
    assert after.cost <= 1.05 * before.cost


@pytest.mark.parametrize('seed', range(6))
def test_smooth_torque(seed):
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1, 1, 4) * [np.pi, 1.0, 5.0, 5.0]
    made = problem(0.09, PendulumStart(*state.tolist()), method='smooth')
    solution = made.solve(ENOUGH)
    trajectory = solution.trajectory
    assert trajectory.interpolation == 'cubic'
    torque = trajectory.control('torque')
    assert np.abs(torque).max() <= 0.09
    steps = np.abs(np.diff(torque)) / np.diff(trajectory.times)
    fine = np.linspace(0.0, trajectory.duration, 4001)
    between = np.abs(np.diff(trajectory.sample(fine).control[:, 0])) / np.diff(fine)
    assert between.max() <= 3.0 * steps.max()
    end = solve_ivp(
        lambda t, x: made.plant.derivative(x, trajectory.sample(t).control),
        (0.0, trajectory.duration),
        trajectory.states[0],
        method='DOP853',
        rtol=1e-9,
        atol=1e-10,
    ).y[:, -1]
    assert_upright(end)


@given(
    size=st.floats(0.1, 10.0),
    mass=st.floats(0.1, 10.0),
    strength=st.floats(3.0, 12.0),
    inertia=st.floats(0.5, 2.0),
)
@settings(deadline=None, derandomize=True, max_examples=10)
def test_rigs_of_any_size(size, mass, strength, inertia):
    small = RotaryPendulum()
    k = mass * size**2
    plant = RotaryPendulum(
        mass=mass * small.mass,
        com_distance=size * small.com_distance,
        arm_length=size * small.arm_length,
        inertia=PendulumInertia(
            disk=k * inertia * small.inertia.disk,
            x=k * small.inertia.x,
            y=k * small.inertia.y,
            z=k * small.inertia.z,
        ),
    )
    limits = PendulumLimits(torque=strength * plant.coefficients.gravity)
    made = PendulumSwingUp(plant=plant, limits=limits, torque_reserve=0.0)
    assert_upright(replay_end(made, made.solve(ENOUGH)))


def test_the_fewest_arcs_allowed_do_for_a_weak_torque():
    # Upright with a little speed: four arcs bring it to rest without pumping.
    start = PendulumStart(theta=0.2, psi=0.1, theta_dot=-0.5, psi_dot=0.0)
    solution = problem(0.02, start, switching_arcs=4).solve(5.0, seed=0)
    assert solution.verification.ok
    assert solution.parameters.size <= 4


@pytest.mark.parametrize('torque', [1e-4, 1e-12])
def test_torque_that_cannot_do_it_is_said_so(torque):
    with pytest.raises(Infeasible, match=r'limits\.torque'):
        problem(torque).solve(0.2)


def test_a_deadline_too_short_is_said_so():
    with pytest.raises(Infeasible, match='in 1e-05 s'):
        problem(0.02).solve(1e-5)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_disk_that_cannot_be_stopped_in_time_is_said_so(sign):
    start = PendulumStart(theta=2.0, psi=sign * 1.5, psi_dot=sign * 9.5)
    with pytest.raises(Infeasible, match=r'start\.psi_dot.*limits\.disk_angle') as caught:
        problem(0.02, start).solve(0.3)
    assert caught.value.code == 'INFEASIBLE'


@pytest.mark.parametrize('method', ['switching', 'smooth'])
def test_motions_that_cannot_be_stopped_are_given_up(method):
    with pytest.raises(Infeasible, match=r'beyond limits\.disk_angle|gave no swing-up'):
        problem(0.02, PendulumStart(psi=1.9, psi_dot=200.0), method=method).solve(0.1)


@pytest.mark.parametrize(
    ('parameters', 'named'),
    [
        ({'plant': {'mass': 0.0}}, ['plant.mass', '0']),
        ({'plant': {'inertia': {'disk': -1e-4}}}, ['plant.inertia.disk', '-0.0001']),
        ({'plant': {'arm_length': float('inf')}}, ['plant.arm_length', 'inf']),
        ({'limits': {'torque': 0}}, ['limits.torque', '0']),
        ({'limits': {'disk_angle': float('nan')}}, ['limits.disk_angle', 'nan']),
        ({'start': {'psi': 2.5}}, ['start.psi', '2.5', '[-2, 2]']),
        ({'start': {'theta': 'up'}}, ['start.theta', 'up']),
        ({'torque_reserve': 1.0}, ['torque_reserve', '1.0', '[0, 1)']),
        ({'torque_reserve': -0.1}, ['torque_reserve', '-0.1']),
        ({'method': 'magic'}, ['method', 'magic', 'switching', 'smooth']),
        ({'goal': {'turns': 0.5}}, ['goal.turns', '0.5']),
        ({'switching_arcs': 3}, ['switching_arcs', '3']),
        ({'plant': {'colour': 1.0}}, ['plant.colour']),
    ],
)
def test_bad_input_is_named(parameters, named):
    with pytest.raises(InvalidProblem) as caught:
        PendulumSwingUp.from_parameters(parameters)
    message = str(caught.value)
    assert all(word in message for word in named)
    assert '\n' not in message


def test_node_parameters_are_left_alone():
    made = PendulumSwingUp.from_parameters({'start.source': 'measured', 'start.theta': 1.0})
    assert made.start.theta == 1.0


def test_problems_are_values():
    assert problem() == problem()
    assert hash(problem()) == hash(problem())
    changed = dataclasses.replace(problem(), torque_reserve=0.1)
    assert changed != problem()

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The floating robot's equations and their compiled replay against independent integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.plants import FloatingRobot
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import replay

ROBOT = FloatingRobot(mass=8.0, inertia=0.05, wheel_inertia=0.002)


def trajectory(times, controls, start, interpolation='linear'):
    states = np.tile(np.asarray(start, dtype=float), (len(times), 1))
    return Trajectory.of(ROBOT, times, states, controls, interpolation)


def random_controls(seed, n=30, duration=6.0):
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.sort(rng.uniform(0.1, duration, n - 2)), [duration + 0.1]])
    controls = rng.uniform(-1, 1, (n, 3)) * [0.4, 1.0, 0.01] + [0.4, 0.0, 0.0]
    return times, controls, rng.uniform(-1, 1, 7)


def integrated(plan, at):
    """Return an integration of its own, restarted at every sample."""
    state, states = plan.states[0], [plan.states[0]]
    for begin, end in zip(plan.times[:-1], plan.times[1:], strict=True):
        inside = at[(at > begin) & (at <= end)]

        def rate(t, x, begin=begin):
            # Inside the interval, so that a held control is the one of its start.
            control = plan.sample(min(max(t, begin + 1e-12), end - 1e-12)).control  # noqa: B023
            return ROBOT.derivative(x, control)

        result = solve_ivp(
            rate, (begin, end), state, rtol=1e-10, atol=1e-12, t_eval=np.union1d(inside, [end])
        )
        states += list(result.y.T[: inside.size])
        state = result.y[:, -1]
    return np.array(states)


@pytest.mark.parametrize('interpolation', ['linear', 'zero_order_hold'])
@pytest.mark.parametrize('turning', [0.0, 1.0, 20.0])
def test_replay_agrees_with_an_independent_integrator(interpolation, turning):
    times, controls, start = random_controls(2)
    controls[:, 1:] *= turning
    start[5] *= turning
    plan = trajectory(times, controls, start, interpolation)
    at = np.linspace(0.0, times[-1], 57)
    assert ROBOT.replay(plan, at) == pytest.approx(integrated(plan, at), abs=2e-7)


def test_verification_replays_splines_by_integration():
    times = np.linspace(0.0, 2.0, 9)
    controls = np.stack([1 + np.sin(times), np.cos(times), 0.01 * times], axis=1)
    plan = trajectory(times, controls, np.zeros(7), 'cubic')
    assert ROBOT.replay(plan, times) is None
    states = replay(ROBOT, plan, times)
    fine = trajectory(
        np.linspace(0.0, 2.0, 2001), plan.sample(np.linspace(0.0, 2.0, 2001)).control, np.zeros(7)
    )
    assert states == pytest.approx(ROBOT.replay(fine, times), abs=1e-6)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Thrust arcs: the rounded polyline and its slopes, plans of least gas, guesses, warm starts."""

from dataclasses import replace

from benchmark.scenarios import crossing
import numpy as np
import pytest
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation.parameters import RobotStart
from tdm_planner.problems.formation.thrust_arcs_kernels import attitude, place, turning
from tdm_planner.problems.formation.thrust_arcs_motion import arc_trajectory, cleaned, remaining
from tdm_planner.problems.formation.thrust_arcs_program import ArcProgram
from tdm_planner.problems.formation.thrust_arcs_search import ArcSeeds

MOVING = {
    'robot1.start.u': 0.02,
    'robot1.start.v': -0.01,
    'robot1.start.omega': 0.02,
    'robot1.start.alpha': 0.4,
}


def problem(seed=0, n=3, **changes):
    settings = {'method': 'thrust_arcs', 'solver.deadline': 20.0, **changes}
    return RobotFormation.from_parameters(crossing(seed, n).parameters(**settings))


def guess(program, seed=0):
    """Parameters Xi near a first guess, with nothing degenerate about them."""
    x = next(ArcSeeds(program, np.random.default_rng(seed)).screened())
    xi = program.reduce(x) + 0.01 * np.random.default_rng(seed).uniform(
        0.5, 1.0, program.free.size
    )
    return np.clip(xi, program.lower, program.upper)


@pytest.mark.parametrize('changes', [{}, MOVING, {'arena.obstacles': [2.0, 2.0, 0.05]}])
@pytest.mark.parametrize('count', [3, 4])
def test_slopes_are_those_of_the_values(changes, count):
    program = ArcProgram(problem(3, **changes).task, count)
    xi = guess(ArcProgram(program.task))
    if count == 4:  # another corner between the start and the first
        x = ArcProgram(program.task).full(xi)
        middle = 0.5 * (x[:, 1:4] + np.column_stack([program.task.start, x[:, 0]]))
        xi = program.reduce(np.column_stack([x[:, 0], middle + 0.02, x[:, 1:]]))
    at = program.evaluate(xi)
    found = program.linearise(at, None)
    weights = program.weights[1]

    def smooth(z):
        point = program.evaluate(z)
        late = np.diff(point.cache.x[:, -1]) - program.task.interval
        return point, point.cost - weights * np.abs(late).sum()

    rows = len(at.cache.approaches)
    for q, step in enumerate(1e-6 * np.eye(xi.size)):
        (after, above), (before, below) = smooth(xi + step), smooth(xi - step)
        assert (above - below) / 2e-6 == pytest.approx(found.gradient[q], rel=2e-4, abs=1e-5)
        if len(after.cache.approaches) == len(before.cache.approaches) == rows:
            slope = (after.cache.closeness - before.cache.closeness) / 2e-6
            assert slope == pytest.approx(found.inequality_jacobian[:rows, q], rel=1e-3, abs=1e-4)


def test_every_polyline_ends_at_its_goal_at_rest():
    program = ArcProgram(problem(1, **MOVING).task)
    task = program.task
    burns = program.evaluate(guess(program)).cache.burns
    x = program.full(guess(program))
    state = np.zeros(6)
    for i in range(task.n):
        place(x[i, -1], task.start[i], task.velocity[i], burns[i], state)
        assert state[:2] == pytest.approx(task.goal[i], abs=1e-6)
        assert state[2:4] == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize('rate', [0.0, 0.1, -0.3])
@pytest.mark.parametrize('way', [0.0, 1.0, -2.0])
def test_the_least_turn_comes_to_rest_where_it_should(way, rate):
    a, switch = turning(10.0, way, rate)
    assert 0.0 <= switch <= 10.0
    assert attitude(10.0, 10.0, a, switch, 0.5, rate, 0.5 + way) == pytest.approx(0.5 + way)
    before, after = (
        attitude(switch + d, 10.0, a, switch, 0.5, rate, 0.5 + way) for d in (-1e-9, 1e-9)
    )
    assert before == pytest.approx(after, abs=1e-6)


@pytest.fixture(scope='module')
def plans():
    found = {}
    for method in ('thrust_arcs', 'polynomials'):
        found[method] = [problem(seed, method=method).solve() for seed in range(4)]
    return found


def test_arcs_cost_less_than_polynomials(plans):
    for arcs, polynomials in zip(*plans.values(), strict=True):
        assert arcs.verification.ok
        assert arcs.cost < 0.98 * polynomials.cost


def test_thrust_is_full_or_off_and_every_switch_a_sample(plans):
    for solution in plans['thrust_arcs']:
        for plan in solution.trajectories.values():
            thrust = plan.control('thrust')
            assert plan.interpolation == 'zero_order_hold'
            assert set(np.unique(thrust)) <= {0.0, thrust.max()}
            burns = remaining(plan)
            # Gas is the impulse of the burns, and the states know of it exactly.
            gas = np.hypot(burns[:, 0], burns[:, 1]).sum()
            exact = plan.control_integral(plan.duration)[0] / 10.5
            assert gas == pytest.approx(exact, rel=1e-6)
            assert np.hypot(burns[:, 0], burns[:, 1]).min() > 2e-4


def test_the_thruster_rests_while_the_robot_coasts(plans):
    plan = plans['thrust_arcs'][0].trajectories['robot1']
    on = plan.control('thrust') > 0.0
    rate = np.abs(plan.control('thruster_rate'))
    resting = np.diff(plan.times)[(~on & (rate < 1e-9))[:-1]].sum()
    assert resting > 0.5 * plan.duration


def test_weak_burns_are_left_out_and_the_others_corrected():
    task = problem().task
    robot, duration = 0, 40.0
    way = task.goal[0] - task.start[0]
    p = way / 38.0
    burns = np.array([[*p, 1.0, 1.0], [1e-4, -1e-4, 20.0, 0.01], [*-p, 39.0, 1.0]])
    kept = cleaned(task, robot, burns, duration, weakest=3e-4)
    assert len(kept) == 2
    flown = arc_trajectory(task, robot, kept, duration)
    missed = flown.states[-1, :4] - [*task.goal[0], 0.0, 0.0]
    assert np.abs(missed).max() < 2e-4  # the thruster turns in steps


def test_zones_moving_starts_and_robots_that_stay():
    drawn = crossing(5)
    stay = {'robot3.start.x': float(drawn.goal[2, 0]), 'robot3.start.y': float(drawn.goal[2, 1])}
    changes = {**MOVING, **stay, 'arena.obstacles': [0.3, 3.7, 0.2], 'arena.tracking_margin': 0.01}
    asked = problem(5, **changes)
    solution = asked.solve()
    assert solution.verification.ok
    assert set(solution.verification.worst) >= {'robot1.keep_out', 'separation robot1-robot3'}
    assert (solution.trajectories['robot3'].control('thrust') == 0.0).all()
    assert solution.trajectories['robot1'].states[0, 6] == pytest.approx(0.4)


def test_many_robots_begin_with_the_plan_of_polynomials():
    arcs, polynomials = (problem(1, 9, method=m).solve() for m in ('thrust_arcs', 'polynomials'))
    assert all(p.interpolation == 'zero_order_hold' for p in arcs.trajectories.values())
    assert arcs.cost < 0.96 * polynomials.cost


@pytest.mark.parametrize('share', [0.05, 0.3, 0.6])
def test_the_rest_of_a_plan_is_its_own_best_continuation(plans, share):
    solution, asked = plans['thrust_arcs'][1], problem(1)
    now = share * min(plan.duration for plan in solution.trajectories.values())
    rest = {name: plan.after(now) for name, plan in solution.trajectories.items()}
    starts, gas = {}, 0.0
    for name, plan in rest.items():
        x, y, u, v, yaw, omega, alpha = plan.states[0].tolist()
        starts[name] = RobotStart(x=x, y=y, u=u, v=v, yaw=yaw, omega=omega, alpha=alpha)
        gas += plan.control_integral(plan.duration)[0] / 10.5
    again = replace(asked, starts=starts).solve(warm_start=replace(solution, trajectories=rest))
    assert again.cost_terms['gas'] / asked.weights.gas == pytest.approx(gas, rel=0.02)
    arrivals = [(again.trajectories[name].duration, plan.duration) for name, plan in rest.items()]
    assert all(new == pytest.approx(old, abs=0.5) for new, old in arrivals)

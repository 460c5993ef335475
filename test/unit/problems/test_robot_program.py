# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Programs over robots' motions, by polynomials and by thrust arcs; thrusters."""

from dataclasses import replace

from benchmark.scenarios import crossing as drawn_crossing
from closed_loop import FORMATION
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import central, faults
from tdm_planner.direct_method.bases import bernstein_basis, reciprocal, time_derivatives
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import RobotFormation, RobotStart
from tdm_planner.problems.formation import thrust_arcs_program
from tdm_planner.problems.formation.polynomial_kernels import unpacked
from tdm_planner.problems.formation.polynomial_plan import ThrustDirection
from tdm_planner.problems.formation.polynomial_search import guesses, PolynomialProgram
from tdm_planner.problems.formation.program import CLOSENESS, scaled, TIME
from tdm_planner.problems.formation.reference_motion import arcs_at, end_derivatives, MotionForm
from tdm_planner.problems.formation.thrust_arcs_program import ThrustArcProgram
from tdm_planner.problems.formation.thrust_arcs_search import ArcSearch
from tdm_planner.problems.formation.thrust_arcs_search import guesses as seeds

TASK = FORMATION.task
FORMS = {
    'default': MotionForm(7, 5, 0, True),
    'paper': MotionForm(7, 7, 0, False),
    'speed factor': MotionForm(7, 5, 2, False),
    'both': MotionForm(9, 7, 1, True),
}
CROWDED = replace(TASK, obstacles=np.array([[2.0, 1.5, 0.2]]), separation=0.8)
MOVES = {'u': 0.02, 'v': -0.01, 'omega': 0.02, 'alpha': 0.4}
MOVING = {f'robot1.start.{name}': value for name, value in MOVES.items()}
TIMES = np.linspace(0.0, 20.0, 401)
RATE, THRUST = 1.0, 0.1


def task_where_one_stays():
    """Return one whose first robot stays; the others move at first, two of them coasting."""
    rng, goal = np.random.default_rng(4), TASK.goal.copy()
    goal[0] = TASK.start[0]
    return replace(
        CROWDED,
        goal=goal,
        velocity=rng.normal(0, 0.05, (3, 2)) * [[0], [1], [1]],
        acceleration=rng.normal(0, 0.02, (3, 2)),
        yaw_rate=rng.normal(0, 0.05, 3),
        coast=np.array([0.5, 0.0, 0.3]),
    )


def program_and_point(form, task, hurry=0.7):
    program, rng = PolynomialProgram(task, FORMS[form]), np.random.default_rng(0)
    x = next(guesses(program, rng))
    x[:, : program.nb] *= hurry  # so little time that thrust is near its limit
    xi = program.reduce(x)
    return program, np.clip(xi + rng.normal(0, 0.1, xi.size), program.lower, program.upper)


@pytest.fixture(params=[(form, case) for form in FORMS for case in ('rest', 'stays')], ids=str)
def made(request):
    form, case = request.param
    return program_and_point(form, CROWDED if case == 'rest' else task_where_one_stays())


@given(form=st.sampled_from([*FORMS.values(), MotionForm(5, 5)]), seed=st.integers(0, 1000))
@settings(max_examples=40)
def test_boundary_conditions_hold_whatever_is_varied(form, seed):
    rng = np.random.default_rng(seed)
    velocity, acceleration = rng.normal(0, 0.05, (3, 3)), rng.normal(0, 0.02, (3, 3))
    task = replace(TASK, coast=rng.uniform(0, 2, 3))
    task = replace(task, velocity=velocity[:, :2], yaw_rate=velocity[:, 2])
    task = replace(task, acceleration=acceleration[:, :2], yaw_acceleration=acceleration[:, 2])
    program = PolynomialProgram(task, form)
    x = rng.normal(0, 0.3, program.units.shape)
    x[:, : program.nb] = rng.uniform(0.6, 1.4, (3, program.nb))
    x *= program.units
    ends = unpacked(program.manoeuvre, x)
    yaws, _ = end_derivatives(form.yaw_order, False)
    given_axes = slice(2 if form.vary_ends else 0, 3)
    for s, place, yaw, rates in (
        (0.0, task.departure, task.departure_yaw, [velocity, acceleration]),
        (1.0, task.goal, task.goal_yaw, np.zeros((2, 3, 3))),
    ):
        b = x[:, : program.nb]
        mu = [(b @ bernstein_basis(form.degree, s, d))[:, None] for d in range(2)]
        path = [program.positions(x) @ program.basis.values(s, d) for d in range(3)]
        turn = [ends[:, 2, : form.yaw_order + 1] @ yaws.values(s, d) for d in range(3)]
        jet = [np.column_stack(both) for both in zip(path, turn, strict=True)]
        at, first, second = time_derivatives(jet, reciprocal(mu))
        assert at == pytest.approx(np.column_stack([place, yaw]), abs=1e-9)
        assert first == pytest.approx(rates[0], abs=1e-9)
        assert second[:, given_axes] == pytest.approx(rates[1][:, given_axes], abs=1e-9)


def own_margins(program, xi):
    """Margins of thrust, torque and walls, (n, ...) each."""
    thrust, torque, _ = np.cumsum([*program.limits.values()])
    return np.split(program.evaluate(xi).cache.own, [thrust, torque], axis=1)


def test_gradient_and_rows_against_differences(made):
    program, xi = made
    at = program.linearise(program.evaluate(xi), None)
    gradient = at.gradient + (at.term_weights * np.sign(at.terms)) @ at.terms_jacobian
    numeric = central(lambda x: program.evaluate(x).cost, xi)
    assert gradient == pytest.approx(numeric, abs=1e-6)
    thrust, torque, walls = own_margins(program, xi)
    near = [thrust < 0.35, torque < 0.5, walls < 1.0]
    assert near[0].any()
    assert near[2].any()
    each = range(program.task.n)

    def margins(x):
        rows = own_margins(program, x)
        every = [row[i][mask[i]] for i in each for row, mask in zip(rows, near, strict=True)]
        return np.concatenate(every)

    count, slopes = margins(xi).size, central(margins, xi)
    assert at.inequalities[:count] == pytest.approx(margins(xi))
    assert at.inequality_jacobian[:count] == pytest.approx(slopes, rel=1e-6, abs=1e-5)


def places(program, xi, t):
    """Positions (n, 2, K) at common instants, coasting before and parked after."""
    task, values = program.task, program.evaluate(xi).cache
    since = t - task.coast[:, None]
    each = zip(values.times, values.times.sum(axis=1), since, strict=True)
    arcs = [arcs_at(*both) for both in each]
    found = program.positions(values.x) @ np.swapaxes(program.basis.values(np.stack(arcs)), 1, 2)
    return found + task.velocity[..., None] * np.minimum(since, 0.0)[:, None]


def test_separations_against_differences(made):
    """At fixed instants, between robots and from what stands still; the nearest are found."""
    program, xi = made
    task, point = program.task, program.evaluate(xi)
    found = point.cache.approaches
    first, second = found[:, :2].astype(int).T
    centres, _ = task.zones()
    every = np.arange(len(found))
    assert (second >= task.n).any()

    def margins(x):
        still = np.repeat(centres[..., None], len(found), axis=2)
        at = np.concatenate([places(program, x, found[:, TIME]), still])
        away = np.linalg.norm(at[first, :, every] - at[second, :, every], axis=1)
        return away / program.clearances[first, second] - 1.0

    rows, at_last = program.linearise(point, None).inequality_jacobian, -len(found)
    assert found[:, CLOSENESS] == pytest.approx(margins(xi), abs=1e-9)
    assert rows[at_last:] == pytest.approx(central(margins, xi), abs=1e-5)
    dense, near = places(program, xi, np.linspace(0.0, 60.0, 6001)), 0
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = np.linalg.norm(dense[one] - dense[other], axis=0).min()
        clearance = program.clearances[one, other]
        if apart < 1.24 * clearance:
            near += 1
            nearest = found[(first == one) & (second == other), CLOSENESS].min()
            assert nearest == pytest.approx(apart / clearance - 1.0, abs=1e-4)
    assert near


def test_hessian_of_the_gas(made):
    """Against differences of the gradient, its eigenvalues lifted alike."""
    program, xi = made
    hessian = program.linearise(program.evaluate(xi), None).hessian

    def gradient(x):
        """Of the smooth part of J."""
        return program.linearise(program.evaluate(x), None).gradient

    numeric = central(gradient, xi, 1e-5)
    n, size = program.units.shape
    blocks = np.zeros((n * size,) * 2)
    blocks[np.ix_(program.free, program.free)] = 0.5 * (numeric + numeric.T)
    robot = np.arange(n)
    blocks = blocks.reshape(n, size, n, size)[robot, :, robot]
    expected = scaled(np.ones((n, size)), blocks, *program.curvature, np.zeros((0, n, size)))
    expected = expected[np.ix_(program.free, program.free)]
    assert hessian == pytest.approx(expected, rel=1e-3, abs=2e-4 * np.abs(expected).max())


def test_names_the_constraint_that_is_violated_most():
    for change, words in (({'torque': 1e-5}, 'limits.torque'), ({'separation': 2.5}, 'arena.')):
        program, xi = program_and_point('default', replace(TASK, **change), hurry=1.0)
        assert words in program.binding(program.evaluate(xi))


def test_held_motions_are_avoided_and_not_varied() -> None:
    every = PolynomialProgram(TASK, FORMS['default'])
    x = np.random.default_rng(3).normal(scale=0.05, size=every.units.shape) * every.units
    x[:, 0] = every.time
    held = np.full_like(x, np.nan)
    held[1] = x[1]
    program = PolynomialProgram(TASK, FORMS['default'], held)
    xi = program.reduce(x)
    assert xi.size == every.reduce(x).size - every.size
    np.testing.assert_array_equal(program.full(xi)[1], x[1])
    np.testing.assert_allclose(program.full(xi), x)
    with_it, without = (p.evaluate(p.reduce(x)).cache for p in (program, every))
    np.testing.assert_allclose(with_it.approaches, without.approaches)
    assert (with_it.own[1] > 1.0).all()
    np.testing.assert_array_equal(with_it.own[[0, 2]], without.own[[0, 2]])
    rows = program.linearise(program.evaluate(xi), None).inequality_jacobian
    assert rows.shape[1] == xi.size
    held[0] = x[0]  # two kept robots leave the third all the room there is
    program = PolynomialProgram(TASK, FORMS['default'], held)
    found = program.evaluate(program.reduce(x)).cache.approaches
    assert (found[:, 1] >= 2).all()


def problem(seed=0, n=3, **changes):
    settings = {'method': 'thrust_arcs', 'solver.deadline': 20.0, **changes}
    return RobotFormation.from_parameters(drawn_crossing(seed, n).parameters(**settings))


def guess(program):
    x = next(seeds(program, np.random.default_rng(0), 1, 0))
    away = np.random.default_rng(0).uniform(0.5, 1.0, program.free.size)
    return np.clip(program.reduce(x) + 0.01 * away, program.lower, program.upper)


@pytest.mark.parametrize('changes', [{}, MOVING, {'arena.obstacles': [2.0, 2.0, 0.05]}])
@pytest.mark.parametrize('count', [3, 4])
def test_slopes_are_those_of_the_values(changes, count):
    program = ThrustArcProgram(problem(3, **changes).task, count)
    xi = guess(ThrustArcProgram(program.task))
    if count == 4:  # another corner between the start and the first
        x = ThrustArcProgram(program.task).full(xi)
        middle = 0.5 * (x[:, 1:4] + np.column_stack([program.task.start, x[:, 0]]))
        xi = program.reduce(np.column_stack([x[:, 0], middle + 0.02, x[:, 1:]]))
    at, weight = program.evaluate(xi), program.weights[1]
    found, rows = program.linearise(at, None), len(at.cache.approaches)

    def smooth(z):
        """Return the smooth part of the cost, and closeness where as many come near."""
        point = program.evaluate(z)
        late = np.diff(point.cache.x[:, -1]) - program.task.interval
        same = len(point.cache.approaches) == rows
        near = point.cache.approaches[:, CLOSENESS] if same else np.full(rows, np.nan)
        return np.append(near, point.cost - weight * np.abs(late).sum())

    *slopes, gradient = central(smooth, xi)
    assert gradient == pytest.approx(found.gradient, rel=2e-4, abs=1e-5)
    expected, known = found.inequality_jacobian[:rows], np.isfinite(slopes)
    assert known.any() == bool(rows)
    assert np.array(slopes)[known] == pytest.approx(expected[known], rel=1e-3, abs=1e-4)


@pytest.fixture(scope='module')
def plans():
    methods = ('thrust_arcs', 'polynomials')
    return {m: [problem(seed, method=m).solve() for seed in range(4)] for m in methods}


def test_arcs_cost_less_than_polynomials_by_thrust_that_is_full_or_off(plans):
    for solution, polynomials in zip(*plans.values(), strict=True):
        assert solution.verification.ok
        assert solution.cost < 0.98 * polynomials.cost
        for plan in solution.trajectories.values():
            thrust = plan.control('thrust')
            assert plan.interpolation == 'zero_order_hold'
            assert set(np.unique(thrust)) <= {0.0, thrust.max()}
            burns = thrust_arcs_program.remaining(plan)
            # Gas is the impulse of the burns, and the states know of it exactly.
            gas = np.hypot(burns[:, 0], burns[:, 1]).sum()
            exact = plan.control_integral(plan.duration)[0] / 10.5
            assert gas == pytest.approx(exact, rel=1e-6)
            assert np.hypot(burns[:, 0], burns[:, 1]).min() > 2e-4


def test_weak_burns_are_left_out_and_the_others_corrected():
    task, duration = problem().task, 40.0
    p = (task.goal[0] - task.start[0]) / 38.0
    burns = np.array([[*p, 1.0, 1.0], [1e-4, -1e-4, 20.0, 0.01], [*-p, 39.0, 1.0]])
    kept = thrust_arcs_program.cleaned(task, 0, burns, duration, weakest=3e-4)
    assert len(kept) == 2
    last = thrust_arcs_program.arc_trajectory(task, 0, kept, duration).states[-1, :4]
    assert np.abs(last - [*task.goal[0], 0.0, 0.0]).max() < 2e-4  # the thruster turns in steps


def test_zones_moving_starts_and_robots_that_stay():
    drawn = drawn_crossing(5)
    stay = {'robot3.start.x': float(drawn.goal[2, 0]), 'robot3.start.y': float(drawn.goal[2, 1])}
    changes = {**MOVING, **stay, 'arena.obstacles': [0.3, 3.7, 0.2], 'arena.tracking_margin': 0.01}
    asked = problem(5, **changes)
    solution = asked.solve()
    assert solution.verification.ok
    assert faults(plan_document(asked, solution)) == []
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
    firsts = {n: zip(p.state_names, p.states[0].tolist(), strict=True) for n, p in rest.items()}
    starts = {name: RobotStart(**dict(first)) for name, first in firsts.items()}
    gas = sum(plan.control_integral(plan.duration)[0] / 10.5 for plan in rest.values())
    again = replace(asked, starts=starts).solve(warm_start=replace(solution, trajectories=rest))
    assert again.cost_terms['gas'] / asked.weights.gas == pytest.approx(gas, rel=0.02)
    for name, plan in rest.items():
        assert again.trajectories[name].duration == pytest.approx(plan.duration, abs=0.5)


def flip(offset=0.0, turns=1):
    """Accelerate and brake `turns` times along x, passing zero at a lateral `offset`."""
    along = THRUST * np.cos(turns * np.pi * TIMES / TIMES[-1])
    return np.stack([along, np.full_like(along, offset)], axis=1)


def follow(wanted, alpha=np.nan, rate=RATE):
    return ThrustDirection(TIMES, wanted, np.zeros(TIMES.size), rate, THRUST, alpha).follow(wanted)


@pytest.mark.parametrize('alpha', [np.nan, -3.0, -0.5, 1.0, 2.5])
@pytest.mark.parametrize('rate', [0.2, 1.0, 3.0])
def test_never_turns_faster_than_the_limit(rate, alpha):
    wanted, yaw = flip(0.1 * THRUST, turns=3), 0.3 * np.sin(0.5 * TIMES)
    angle, speed = ThrustDirection(TIMES, wanted, yaw, rate, THRUST, alpha).follow(wanted)
    assert np.abs(speed).max() <= rate
    steps = np.diff(TIMES) * (speed[1:] + speed[:-1]) / 2
    assert np.diff(angle) == pytest.approx(steps, abs=1e-12)
    assert np.isnan(alpha) or angle[0] == alpha


def test_the_branch_survives_small_changes():
    wanted, yaw = flip(1e-4 * THRUST, turns=3), np.zeros(TIMES.size)
    direction = ThrustDirection(TIMES, wanted, yaw, RATE, THRUST, np.nan)
    first, _ = direction.follow(wanted)
    second, _ = direction.follow(flip(-1e-4 * THRUST, turns=3))
    assert second == pytest.approx(first, abs=0.2)


def test_starts_where_the_thruster_stands_and_turns_during_a_coast():
    angle, speed = follow(np.where(TIMES[:, None] < 3.0, 0.0, [[0.08, 0.0]]), 2.5)
    assert angle[0] == 2.5
    assert angle[TIMES > 3.0] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(speed).max() <= RATE
    resting, speed = follow(np.zeros((401, 2)), 0.7)
    assert (resting == 0.7).all()
    assert not speed.any()


def lateral_error(wanted, heading):
    """Largest component of the wanted acceleration across the thrust, or against it."""
    across = wanted[:, 1] * np.cos(heading) - wanted[:, 0] * np.sin(heading)
    along = wanted[:, 0] * np.cos(heading) + wanted[:, 1] * np.sin(heading)
    return float(np.hypot(across, np.minimum(along, 0.0)).max())


def test_turns_round_while_little_thrust_is_wanted_and_a_slower_thruster_errs_more():
    wanted = flip()
    angles = [follow(wanted, rate=rate)[0] for rate in (2.0, RATE, 0.5)]
    assert abs(angles[1][-1] - angles[1][0]) == pytest.approx(np.pi, abs=1e-6)
    # Half a turn takes pi s; while it is more than pi / 2 off, at most as long to either side, the
    # wanted acceleration is under sin(pi^2 / 40) F_max.
    errors = [lateral_error(wanted, angle) for angle in angles]
    assert errors[1] < 1.3 * THRUST * np.sin(np.pi**2 / 40)
    assert errors[0] < errors[1] < errors[2]


def test_minima_that_cannot_be_polished_are_planned_with(monkeypatch):
    monkeypatch.setattr(ArcSearch, '_polished', lambda *_: [])  # as where the time is up meanwhile
    assert problem(1).solve().verification.ok

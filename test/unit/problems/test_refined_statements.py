# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Stated plants that only the refinement's own care solves: kinks in limits, unstable motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

from brachistochrone import Brachistochrone, cycloid_time
from closed_loop import Loop, tracked
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import replayed
from scipy.linalg import expm
from stated import Car, Cart, changed, LONG, noted, QUICKEST, Quickest
from tdm_planner.arrays import exponentials
from tdm_planner.direct_method import Budget, Duration, Integrated, Output
from tdm_planner.direct_method.collocation import CollocatedMotion
from tdm_planner.exceptions import Infeasible
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectSolverParameters, Solution
from tdm_planner.problems.direct.minima import DirectMinima
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import Refinement
from tdm_planner.problems.direct.search import DirectSearch
from tdm_sim.study.flights import tracker_of

POSTS = ((3.5, 0.2), (7.0, -0.2), (10.5, 0.2))
FREE, KEPT = ({'free': n, 'derivatives': 1} for n in (9, 6))


def margins_of_slalom(self, t, x, u):
    sideways = x[3] * u[1]
    grip = {'left': 3.0 - sideways, 'right': 3.0 + sideways}
    if self.folded:
        grip = {'grip': 3.0 - np.abs(sideways)}
    return grip | {f'{px:g}': np.hypot(x[0] - px, x[1] - py) - 1.5 for px, py in POSTS}


SLALOM = changed(
    Quickest,
    states={'x': 'm', 'y': 'm', 'yaw': 'rad', 'v': 'm/s'},
    controls={'a': 'm/s^2', 'omega': 'rad/s'},
    guess=6.0,
    outputs=lambda s: {'yaw': Output((0.0,), (0.0,), **FREE), 'v': Output((0.5,), (0.5,), **KEPT)},
    integrated=lambda s: {'x': Integrated(0.0, 14.0), 'y': Integrated(0.0, 0.0)},
    invert=lambda s, y, z: ((z['x'], z['y'], y['yaw'][0], y['v'][0]), (y['v'][1], y['yaw'][1])),
    derivative=lambda s, x, u: (x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), u[1], u[0]),
    control_limits=lambda s: {'a': (-1.5, 1.5), 'omega': (-1.5, 1.5)},
    margins=margins_of_slalom,
)


def test_an_absolute_value_in_a_limit_costs_nothing() -> None:
    """Collocation that meets the kink at every turn ended 16 % above this, or nowhere."""
    folded, smooth = (changed(SLALOM, folded=how)().solve() for how in (True, False))
    assert folded.cost == pytest.approx(smooth.cost, rel=1e-3)
    assert folded.cost < 5.61


@dataclass(frozen=True)
class Boat(Quickest):
    state_names, state_units = ('x', 'y', 'vx', 'vy'), ('m', 'm', 'm/s', 'm/s')
    control_names, control_units = ('fx', 'fy'), ('m/s^2', 'm/s^2')
    guess = 30.0
    slow: float = parameter(0.0, 'speed below which the drag is linear', unit='m/s')

    def outputs(self):
        ends = {'x': 30.0, 'y': 10.0}
        return {n: Output(start=(0.0, 0.0), end=(e, 0.0), free=6) for n, e in ends.items()}

    def drag(self, vx, vy):
        return 0.5 * np.sqrt(vx**2 + vy**2 + self.slow**2)

    def invert(self, y, z):
        (x, vx, ax), (p, vy, ay) = y['x'], y['y']
        k = self.drag(vx, vy)
        return (x, p, vx, vy), (ax + k * (vx - 0.5), ay + k * vy)

    def derivative(self, x, u):
        k = self.drag(x[2], x[3])
        return x[2], x[3], u[0] - k * (x[2] - 0.5), u[1] - k * x[3]

    def margins(self, t, x, u):
        return {'force': 1.0 - np.hypot(u[0], u[1])}


def test_drag_that_has_no_slope_at_rest_is_no_obstacle_to_the_optimum_or_the_tracker() -> None:
    """Ipopt meets 0 / 0 there: plans were those of the direct method, 5 % above, or none."""
    singular, smooth = (Boat(slow=slow).solve() for slow in (0.0, 0.01))
    assert singular.trajectory.interpolation == 'linear'
    assert singular.cost == pytest.approx(smooth.cost, rel=1e-3)
    by_state, by_control = DirectPlant(Boat()).jacobians(np.zeros((2, 4)), np.zeros((2, 2)))
    assert by_state[0, :2, 2:] == pytest.approx(np.eye(2))
    assert by_state[1, 2:, 2:] == pytest.approx(np.zeros((2, 2)), abs=1e-6)
    assert by_control[1, 2:] == pytest.approx(np.eye(2))


def test_limits_without_a_slope_at_rest_are_kept_by_collocation() -> None:
    """Straight on, speeding up, at the limit, braking; a force of nothing has no direction."""
    ends = {n: Output((0.0,) * 3, (e, 0.0, 0.0)) for n, e in (('x', 30.0), ('y', 10.0))}
    softly = changed(
        Boat,
        outputs=lambda s: ends,
        drag=lambda s, vx, vy: 0.0,
        margins=lambda s, t, x, u: Boat.margins(s, t, x, u) | {'fast': 4.0 - np.hypot(x[2], x[3])},
    )
    plan = softly().solve()
    assert plan.trajectory.interpolation == 'linear'
    assert plan.cost == pytest.approx(np.hypot(30.0, 10.0) / 4.0 + 4.0, rel=0.02)


@pytest.mark.parametrize(('way', 'step'), [(3.0, 2e-4), (11.0, 5e-5)])
def test_an_unstable_plant_lands_where_its_controls_lead(way: float, step: float) -> None:
    """A rod upright on a cart, moved by 3 or 11 m: e^15, e^24 times what it is off at first."""
    stiffness = 6.5**2  # 1/s^2
    problem = changed(
        Quickest,
        states={'x': 'm', 'v': 'm/s', 'phi': 'rad', 'omega': 'rad/s'},
        controls={'a': 'm/s^2'},
        outputs=lambda s: {'phi': Output(start=(0.0, 0.0), end=(0.0, 0.0), free=10)},
        integrated=lambda s: {'x': Integrated(-way, 0.0), 'v': Integrated(0.0, 0.0)},
        invert=lambda s, y, z: (
            (z['x'], z['v'], *y['phi'][:2]),
            (9.81 * (y['phi'][0] - y['phi'][2] / stiffness),),
        ),
        derivative=lambda s, x, u: (x[1], u[0], x[3], stiffness * (x[2] - u[0] / 9.81)),
        control_limits=lambda s: {'a': (-4.0, 4.0)},
        margins=lambda s, t, x, u: {'lean': 0.3 - np.abs(x[2])},
    )()
    plan = problem.solve().trajectory.to_dict()
    *_, (_, state, _) = replayed(plan, problem.derivative, step)
    assert np.abs(state).max() < 2e-3


@dataclass(frozen=True)
class Pushed(Quickest):
    """A body pushed by 1 m in least time, 2 s; its force is counted in any `unit`."""

    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('force',), ('N',)
    unit: float = parameter(1.0, 'largest force, which is also the mass', unit='N')

    def outputs(self):
        return {'x': Output(start=(-1.0, 0.0), end=(0.0, 0.0), free=6)}

    def invert(self, y, z):
        x, v, a = y['x']
        return (x, v), (self.unit * a,)

    def derivative(self, x, u):
        return x[1], u[0] / self.unit

    def margins(self, t, x, u):
        return {'force': self.unit - np.abs(u[0])}


@pytest.mark.parametrize('unit', [1e-8, 1e-3, 1.0, 1e5])
def test_a_limit_in_any_unit_is_kept_to_the_same_share(unit: float) -> None:
    """In small units a violation was within the tolerance, however many times the limit."""
    plan = Pushed(unit=unit).solve()
    assert np.abs(plan.trajectory.controls).max() <= (1.0 + 2e-4) * unit
    assert plan.cost == pytest.approx(2.0, rel=2e-3)
    assert DirectPlant(Pushed(unit=unit)).limit_tolerances(plan.trajectory) <= 1e-3 * unit


def test_a_statement_need_not_mention_the_solver() -> None:
    problem = Pushed.from_parameters({'unit': 4.0, 'solver': {'deadline': 60.0}})
    assert problem.solver == DirectSolverParameters(deadline=60.0)
    assert problem.solve().duration == pytest.approx(2.0, rel=2e-3)
    assert next(iter(Car.parameter_specifications({}))) == 'drag'
    heir = dataclass(frozen=True)(type('Heir', (Pushed,), {}))
    assert heir(unit=2.0, solver=LONG).solver is LONG


def test_feedback_keeps_a_limit_in_any_unit() -> None:
    problem = Pushed(unit=1e-8)
    plan = problem.solve().trajectory
    loop = Loop(tracked(tracker_of(problem), plan.states[0], 0.1, 1.0, 0)).begin(plan).run(4.0)
    assert np.abs(loop.controls).max() <= 1.002 * problem.unit
    assert np.abs(loop.plant.state).max() < 0.01


@dataclass(frozen=True)
class Between(Quickest):
    """The shortest way, at a speed of 1 m/s at most, past a limit of any shape."""

    state_names, state_units = ('x', 'y'), ('m', 'm')
    control_names, control_units = ('u', 'v'), ('m/s', 'm/s')
    guess = 5.0
    kind: str = parameter('lens', 'which limit')
    turn: float = parameter(1.0, 'sign of the lens', unit='')

    def outputs(self):
        return {n: Output((-s,), (s,), free=6, derivatives=1) for n, s in (('x', 2.0), ('y', 0.0))}

    def invert(self, y, z):
        (x, u), (p, v) = y['x'], y['y']
        return (x, p), (u, v)

    def derivative(self, x, u):
        return u

    def margins(self, t, x, u):
        limits = {
            'lens': lambda: self.turn * (0.5 - np.abs(x[1])) + x[0] ** 2,
            'pole': lambda: (2.5 - x[0]) / (np.sqrt(u[0] ** 2 + u[1] ** 2) + 1e-9) - 0.6,
            'line': lambda: -np.abs(x[1]),
        }
        return {'fast': 1.0 - u[0] ** 2 - u[1] ** 2, self.kind: limits[self.kind]()}


def test_limits_that_turn_round_have_a_pole_or_vanish_are_kept_as_others() -> None:
    """Of one kind of limit two problems in turn; a pole is no size, and nothing is one either."""
    straight, round_it = (Between(turn=turn).solve() for turn in (1.0, -1.0))
    assert straight.cost == pytest.approx(4.0, rel=1e-3)
    assert round_it.cost == pytest.approx(4.1265, rel=1e-3)
    assert Between(kind='line').solve().cost == pytest.approx(4.0, rel=1e-3)
    slowed = Between(kind='pole').solve()
    assert slowed.verification.worst['pole'] > -2e-5
    fast = replace(slowed.trajectory, controls=2.0 * slowed.trajectory.controls)
    assert DirectPlant(Between(kind='pole')).limit_tolerances(fast).max() < 1e-4


@pytest.mark.parametrize('free', [2, 3, 6])
def test_what_collocation_does_not_find_the_direct_method_does(free: int) -> None:
    """A slope that nothing holds, no speed at first: one of three ended at the straight line."""
    problem = Brachistochrone(free=free)
    best = cycloid_time(problem.across, problem.down, problem.gravity)
    assert problem.solve().cost == pytest.approx(best, rel=1e-4)


def on_the_limit(fastest: float, beyond: float):
    ends = {'x': Output((0.0, (1.0 + beyond) * fastest), (fastest, 0.0), free=3)}
    limit = {'margins': lambda s, t, x, u: {'speed': fastest - x[1]}}
    return changed(Cart, outputs=lambda s: ends, **limit)


def cone_at_the_goal(self, t, x, u):
    cone = 4.0 * (30.0 - x[0]) - np.hypot(x[0] - 30.0, x[1] - 10.0)
    return Boat.margins(self, t, x, u) | {'cone': cone}


ON_LIMITS = [on_the_limit(most, off) for most in (0.1, 0.3, 0.7, 1.1) for off in (0.0, 1e-9)]


@pytest.mark.parametrize('made', [*ON_LIMITS, changed(Boat, margins=cone_at_the_goal)])
def test_an_end_on_a_limit_but_for_rounding_or_on_its_kink_is_collocated(made) -> None:
    """The kink rounded would be violated at the goal, where nothing can be changed."""
    plan = made(solver=LONG).solve()
    assert plan.trajectory.interpolation == 'linear'  # else the direct method's own


def test_conditions_at_the_end_are_corrected_as_a_given_end_is() -> None:
    """Thrust that turns round within an interval: integrated, the orbit ended 2e-3 off."""
    free = {name: Output((0.0, 0.5), (), free=6) for name in ('x', 'y')}
    orbit = changed(
        Boat,
        outputs=lambda s: free,
        drag=lambda s, vx, vy: np.sin(3.0 * vx) * np.cos(2.0 * vy),
        end_conditions=lambda s, t, x: (x[0] ** 2 + x[1] ** 2 - 9.0, x[0] * x[2] + x[1] * x[3]),
    )(solver=LONG)
    plant = DirectPlant(orbit)
    plan = orbit.solve().trajectory
    refinement = Refinement(plant, Budget(math.inf))
    sample = plan.sample(np.linspace(0.0, plan.duration, 161))
    states, controls = sample.state, 0.995 * sample.control[::2]
    weaker = CollocatedMotion(states[::2], states[1::2], controls, plan.duration)
    before, (motion, after) = refinement._replayed(weaker), refinement._landed(weaker)
    assert before.gap > 1.0 > 10.0 * after.gap
    _, slopes = plant.end_conditions(motion.duration, after.states[-1])
    x, y, vx, vy = after.states[-1]
    np.testing.assert_allclose(slopes, [[2 * x, 2 * y, 0, 0, 0], [vx, vy, x, y, 0]], atol=1e-12)


def test_what_only_the_check_sees_violated_is_kept_the_next_time(monkeypatch) -> None:
    """It looks at more instants than the replay before: a plan of 160 intervals was given up."""
    checked: list[Solution] = []
    planned = DirectSearch.checked

    def stricter(self, *given):
        plan = planned(self, *given)
        checked.append(plan)
        if len(checked) > 1:
            return plan
        worst = plan.verification.worst | {'force': -0.01}
        check = replace(plan.verification, ok=False, reasons=('force',), worst=worst)
        return replace(plan, verification=check)

    monkeypatch.setattr(DirectSearch, 'checked', stricter)
    plan = changed(Boat, drag=lambda s, vx, vy: 0.0)(solver=LONG).solve()
    first, second = checked[:2]
    assert len(second.trajectory.times) == len(first.trajectory.times)
    largest = np.hypot(*second.trajectory.controls[1:-1].T).max()
    assert 1.0 - largest == pytest.approx(0.015, rel=0.1)
    assert plan.verification.ok


def thrust_and_mass(self, x, u):
    thrust = np.sqrt(u[0] ** 2 + u[1] ** 2 + 1e-4)
    return x[2], x[3], u[0] / x[4], u[1] / x[4] - 1.6, -thrust / 500.0


FALLING = {'x': (380.0, -20.0), 'z': (400.0, -30.0)}
LANDING = changed(
    Quickest,
    __doc__='Least propellant to a point on the limit: the tip of a cone to stay in.',
    states={'x': 'm', 'z': 'm', 'vx': 'm/s', 'vz': 'm/s', 'm': 'kg'},
    controls={'fx': 'N', 'fz': 'N'},
    guess=20.0,
    outputs=lambda s: {n: Output(start, (0.0, 0.0), free=6) for n, start in FALLING.items()},
    integrated=lambda s: {'m': Integrated(1.0, scale=1.0)},
    invert=lambda s, y, z: (
        (y['x'][0], y['z'][0], y['x'][1], y['z'][1], z['m']),
        (y['x'][2] * z['m'], (y['z'][2] + 1.6) * z['m']),
    ),
    derivative=thrust_and_mass,
    margins=lambda s, t, x, u: {
        'cone': (x[1] - np.sqrt(x[0] ** 2 + 1e-12)) / 1000.0,
        'thrust': 1.0 - (u[0] ** 2 + u[1] ** 2) / 25.0,
    },
    final_cost=lambda s, t, x: -x[4],
)


def test_a_goal_on_a_limit_is_met_as_closely_as_the_limit_asks(monkeypatch) -> None:
    """The end was off by 12 mm, which no reserve mends: one was added again and again."""
    tried = noted(monkeypatch, Refinement, 'solve')
    assert LANDING(solver=LONG).solve().verification.ok
    assert not any(np.any(call.kwargs.get('reserve', 0.0)) for call in tried.call_args_list)


@given(st.integers(0, 100), st.sampled_from([1e-6, 1e-2, 1.0, 20.0]))
@settings(max_examples=20)
def test_exponentials_of_many_matrices(seed, size) -> None:
    matrices = size * np.random.default_rng(seed).normal(size=(3, 5, 5))
    exact = expm(matrices)
    np.testing.assert_allclose(exponentials(matrices), exact, atol=1e-12 * np.abs(exact).max())
    np.testing.assert_array_equal(exponentials(0.0 * matrices), np.tile(np.eye(5), (3, 1, 1)))


def test_a_condition_that_asks_nothing_and_limits_that_leave_one_value() -> None:
    """A row that is zero had no place in the program, bounds that cross by rounding none left."""
    fixed = changed(
        Cart,
        controls={'u': 'm/s^2', 'spare': 'm'},
        invert=lambda s, y, z: (y['x'][:2], (y['x'][2], 0.0 * y['x'][0])),
        end_conditions=lambda s, t, x: [0.0 * x[0]],
        margins=lambda s, t, x, u: {'up': u[1], 'down': -1e-17 - u[1]},
    )(solver=LONG)
    assert fixed.solve().cost == pytest.approx(12.0 / fixed.time**3, rel=1e-3)


def test_no_initial_guess_is_minimised_twice(monkeypatch):
    tried = []
    monkeypatch.setattr(Refinement, 'from_guess', lambda *_, **__: None)
    note = lambda self, _, xi, __: tried.append(xi.tobytes())  # noqa: E731
    monkeypatch.setattr(DirectMinima, 'minimise_fully', note)
    with pytest.raises(Infeasible):
        changed(Cart, **QUICKEST)(solver=LONG).solve()
    assert len(set(tried)) == len(tried) > 2 * Cart.starts


def test_states_of_any_size() -> None:
    """An orbit raised in SI units, 7e6 m beside 1e-3 rad/s: it stayed 4 % above the optimum."""
    mu, low, high = 3.986004418e14, 6.778e6, 6.978e6
    first, last = (math.sqrt(mu / r**3) for r in (low, high))
    raised = changed(
        Quickest,
        states={'r': 'm', 'angle': 'rad', 'climb': 'm/s', 'rate': 'rad/s'},
        controls={'up': 'm/s^2', 'along': 'm/s^2'},
        outputs=lambda s: {
            'r': Output((low, 0.0), (high, 0.0), free=8),
            'angle': Output((0.0, first), (None, last), free=8),
        },
        duration=lambda s: Duration(5000.0, fixed=True),
        invert=lambda s, y, z: (
            (y['r'][0], y['angle'][0], y['r'][1], y['angle'][1]),
            (
                y['r'][2] - y['r'][0] * y['angle'][1] ** 2 + mu / y['r'][0] ** 2,
                y['r'][0] * y['angle'][2] + 2.0 * y['r'][1] * y['angle'][1],
            ),
        ),
        derivative=lambda s, x, u: (
            x[2],
            x[3],
            u[0] + x[0] * x[3] ** 2 - mu / x[0] ** 2,
            (u[1] - 2.0 * x[2] * x[3]) / x[0],
        ),
        control_limits=lambda s: {'up': (-0.06, 0.06), 'along': (-0.06, 0.06)},
        running_cost=lambda s, t, x, u: u[0] ** 2 + u[1] ** 2,
        final_cost=lambda s, t, x: 0.0,
    )
    plan = raised(solver=LONG).solve()
    assert plan.cost == pytest.approx(2.527404, rel=1e-3)  # on 160 intervals, scaled by hand

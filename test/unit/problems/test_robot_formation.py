# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plans of robot formations, integrated by equations of their own; robots added or left out."""

from dataclasses import replace
import math

from closed_loop import FORMATION
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from replays import faults
from stated import refused
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import RobotFormation, RobotStart, Solution
from tdm_planner.problems.formation import verification
from tdm_planner.problems.formation.parameters import with_number_of_robots
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import check

PATIENT = {'solver.deadline': 60.0, 'method': 'polynomials'}
CAT = {'robots': ['ant'], 'formation.cat': [0.0, 0.0, 0.0], 'cat.start.x': 0.5}
IN_PLACE = {'formation.anchor': [0.0, 0.0, 0.0]}


def formation(**values):
    return RobotFormation.from_parameters(PATIENT | values)


def pose(name, start, goal, **more):
    """Parameters of one robot from `start` to `goal`, both x, y, yaw in the arena's frame."""
    values = dict(zip(('x', 'y', 'yaw'), start, strict=True)) | more
    begin = {f'{name}.start.{key}': value for key, value in values.items()}
    return begin | {f'formation.{name}': list(goal)}


def flown(problem, **options):
    solution = problem.solve(**options)
    assert solution.verification.ok
    assert faults(plan_document(problem, solution)) == []
    for stays, plan in zip(problem.task.staying, solution.trajectories.values(), strict=True):
        assert not (stays and plan.control('thrust').any())
    return solution


@pytest.fixture(scope='module')
def default() -> Solution:
    return flown(formation())


def test_default_problem(default):
    problem = formation()
    assert default.duration < 30
    assert (default.penalty, default.parameters.size) == (0, 27)
    assert set(default.trajectories) == set(default.verifications) == set(problem.robots)
    assert default.cost == pytest.approx(sum(default.cost_terms.values()))
    for motion in default.trajectories.values():
        with pytest.raises(ValueError, match='read-only'):
            motion.states[0] = 0.0
    plans = dict(default.trajectories)
    assert problem.assess(plans).verification.ok
    over = plans['robot2'].controls.copy()
    over[5, 0] = 1.2 * problem.limits.thrust
    plan = problem.assess(plans | {'robot2': replace(plans['robot2'], controls=over)})
    assert not plan.verification.ok
    assert any('robot2: thrust is violated' in reason for reason in plan.verification.reasons)
    assert plan.penalty > 0


def alone(start, goal, name='only', **more):
    return {'robots': [name]} | IN_PLACE | pose(name, start, goal, **more)


ACROSS = (0.5, 2.0, 0.0), (3.5, 2.0, 0.0)
HERE = 2.0, 2.0, 0.0
NINE = [f'robot{i}' for i in range(1, 10)]
AISLE = {'robots': NINE, 'arena.length': 10.0, 'arena.width': 0.4} | IN_PLACE
for i, name in enumerate(NINE):
    AISLE |= pose(name, (0.5 + 0.8 * i, 0.2, 0.0), (1.2 + 0.8 * i, 0.2, 0.0))
TWO = {'robots': ['left', 'right']} | IN_PLACE
MOVER = pose('right', (3.0, 2.0, 0.0), (1.0, 2.0, 0.0))
SWAP = TWO | MOVER | pose('left', (1.0, 2.0, 0.0), (3.0, 2.0, 0.0))
STILL = TWO | pose('right', (0.5, 2.0, 0.0), (3.5, 2.0, 0.0))
THRUSTERS = {f'robot{i}.start.alpha': 1.0 for i in (1, 2, 3)}
MOVING = {'robot1.start.u': 0.1, 'robot2.start.v': 0.05, 'robot2.start.omega': 0.3}
VARIANTS = {
    'paper': ({'end_accelerations': 'given', 'yaw_order': 7}, 21),
    'speed': ({'end_accelerations': 'given', 'speed_factor_order': 2}, 21),
    '9': ({'polynomial_order': 9}, 39),
    '11': ({'polynomial_order': 11, 'end_accelerations': 'given'}, 39),
    'five': (with_number_of_robots({}, 5), None),
    'swap': (SWAP, None),
    'still': (STILL | pose('left', (2.0, 2.0, 0.0), (2.0, 2.0, 0.0)), None),
    'turning': (STILL | pose('left', (2.0, 2.0, 0.0), (2.0, 2.0, 2.0)), None),
    'stay': (alone((2.0, 2.0, 0.1), (2.0, 2.0, 0.1)), None),
    'turning, alone': (alone(HERE, (2.0, 2.0, 0.4)) | {'weights.time': 0.0}, None),
    'slow thruster': (
        alone(HERE, (2.3, 2.0, 0.0), alpha=3.0) | {'limits.thruster_rate': 0.5},
        None,
    ),
    'aisle': (AISLE | {'method': 'thrust_arcs', 'solver.starts': 1}, None),
    'zones': (alone(*ACROSS) | {'arena.obstacles': [1.5, 2.0, 0.3, 2.6, 2.2, 0.2]}, None),
    'moving': (MOVING | {'speed_factor_order': 2}, None),
    'moving, thrusters too': (MOVING | THRUSTERS, None),
}


@pytest.mark.parametrize(('changes', 'varied'), VARIANTS.values(), ids=VARIANTS)
def test_variants_of_the_method_and_of_the_task(changes, varied):
    solution = flown(formation(**changes))
    assert varied in (None, solution.parameters.size)


def test_the_tolerance_is_what_the_minimiser_is_content_with():
    """Robots that pass as near as allowed: the less of it is feasible, the longer it takes."""
    evaluations = []
    for tolerance in (1e-6, 1e-9, 1e-12):
        made = formation(**{'solver.tolerance': tolerance, 'arena.tracking_margin': 0.0})
        solution = made.solve()
        assert solution.penalty <= tolerance
        evaluations.append(solution.evaluations)
    assert evaluations[0] < evaluations[1] < evaluations[2]


@pytest.mark.parametrize('side', [0, 1])
@pytest.mark.parametrize('beyond', [False, True])
def test_robots_keep_half_a_separation_from_every_wall(side, beyond):
    task = FORMATION.task
    walls = {limit.name: limit for limit in verification.robot_constraints(task)}['walls']
    states = np.full((1, 7), 0.5 * task.sides.min())
    states[0, side] = (task.sides[side] if beyond else 0.0) + 0.1 * (1 if beyond else -1)
    margin = walls.margin(np.zeros(1), states, np.zeros((1, 3)))
    assert margin == pytest.approx([-0.1 - 0.5 * task.separation])


def test_robots_that_pass_through_each_other_between_two_instants_collide() -> None:
    """At 300 m/s, faster than instants 10 ms apart show."""
    large = {'arena.length': 40.0, 'arena.width': 40.0}
    places = (
        pose('left', (10.0, 9.0, 0.0), (15.0, 9.0, 0.0)),
        pose('right', (25.75, 9.0, 0.0), (20.0, 9.0, 0.0)),
    )
    problem = formation(**TWO, **large, **places[0], **places[1])
    motions = {}
    for name, first, speed in (('left', 10.0, 150.0), ('right', 25.75, -150.0)):
        states = np.zeros((2, 7))
        states[:, :3] = [[first, 9.0, speed], [first + 0.1 * speed, 9.0, speed]]
        times, controls = np.array([0.0, 0.1]), np.zeros((2, 3))
        motions[name] = Trajectory.of(problem.plant, times, states, controls)
    worst = problem.assess(motions).verification.worst
    assert min(worst.values()) < -0.9 * problem.arena.minimum_separation


def test_a_robot_that_hardly_drifts_from_its_goal_makes_no_plan_dearer():
    """In a manoeuvre of a minute it would leave its goal, and be planned for by polynomials."""
    slow = {'weights.time': 0.002, 'limits.thrust': 0.3, 'limits.thruster_rate': 0.5}
    stay = {**STILL, **pose('left', (2.0, 2.0, 0.0), (2.0, 2.0, 0.0)), **slow}
    costs = [formation(**stay, **{'left.start.v': v}).solve(counted=True).cost for v in (0, 9e-5)]
    assert costs[1] == pytest.approx(costs[0])


def test_a_penalty_above_the_tolerance_is_no_plan(default, monkeypatch):
    problem, motions = formation(), default.trajectories
    monkeypatch.setattr(verification, 'penalty', lambda *values: 2e-7)
    assert problem.recovered(motions).penalty == 2e-7
    stricter = replace(problem, solver=replace(problem.solver, tolerance=1e-7))
    with pytest.raises(VerificationFailed, match=r'^the penalty 2e-07 is above solver\.tolerance'):
        stricter.recovered(motions)


def test_weights_do_what_they_say():
    quick = formation(**{'weights.gas': 0.0}).solve()
    frugal = formation(**{'weights.time': 0.001, 'weights.sequence': 0.001}).solve()
    gas = [sum(p.control('thrust').mean() * p.duration for p in s.trajectories.values())
           for s in (quick, frugal)]  # fmt: skip
    assert quick.duration < 0.7 * frugal.duration
    assert gas[1] < 0.7 * gas[0]


def test_warm_start_from_an_active_plan(default):
    problem, plan, names = formation(), default, ('x', 'y', 'u', 'v', 'yaw', 'omega', 'alpha')
    now = 0.4 * plan.trajectories['robot1'].duration
    starts = {
        name: RobotStart(**dict(zip(names, motion.sample(now).state.tolist(), strict=True)))
        for name, motion in plan.trajectories.items()
    }
    later = replace(problem, starts=starts)
    again = flown(later, warm_start=TimedPlan(problem, plan, 0.0).remainder(now))
    assert again.duration == pytest.approx(plan.duration - now, rel=0.15)
    assert again.evaluations < later.solve().evaluations


def test_verification_catches_collisions_with_robots_that_have_arrived():
    """Robot 2 passes over the goal of robot 1 after robot 1 has been parked there."""
    apart = {'robots': ['first', 'second'], **IN_PLACE}
    first = pose('first', (1.0, 2.0, 0.0), (2.0, 2.0, 0.0))
    second = (3.5, 2.0, 0.0), (0.5, 2.0, 0.0)
    alongside = formation(**apart, **first, **pose('second', (3.5, 1.0, 0.0), (0.5, 1.0, 0.0)))
    other = formation(**alone(*second, name='second'))
    plans = {**alongside.solve().trajectories, **other.solve().trajectories}
    plan = formation(**apart, **first, **pose('second', *second)).assess(plans)
    assert not plan.verification.ok
    assert plan.verification.worst['separation first-second'] < -0.3
    assert plan.penalty > 1e-3


def test_no_plan_is_explained():
    with pytest.raises(DeadlineExceeded, match='within 1e-06 s'):
        formation(**alone(*ACROSS), **{'arena.obstacles': [2.0, 2.0, 0.7]}).solve(deadline=1e-6)
    late = {'solver.longest': 11.0, 'solver.starts': 2}
    with pytest.raises(Infeasible, match=r"limits\.thrust of 'only'"):
        formation(**alone(*ACROSS), **late).solve()


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'robots': []}, "'robots'"),
        ({'robots': ['a', 'a']}, "names 'a' twice"),
        ({'robots': ['no dots.']}, 'letters, digits'),
        ({'robots': ['plant']}, "'plant', which is the name of a group"),
        ({'robots': ['newcomer']}, "state of robot 'newcomer' is missing"),
        ({'formation.robot9': [0.0, 0.0, 0.0]}, "'formation.robot9' is unknown"),
        ({'formation.ancho': [0.0, 0.0, 0.0]}, 'did you mean formation.anchor or '),
        ({'robot1.start.speed': 0.0}, 'did you mean robot1.start.'),
        (CAT, "'formation.cat' is unknown to robot_formation: 'cat' is not among robots = [ant]"),
        ({'robot1.start.x': 0.1}, "start of 'robot1' has x = 0.1"),
        ({'formation.robot2': [5.0, 0.0, 0.0]}, "goal of 'robot2' has"),
        ({'robot1.start.x': 3.3, 'robot1.start.y': 0.8}, "starts of 'robot1' and 'robot2'"),
        ({'formation.robot1': [-0.2, 0.39, 0.0]}, "goals of 'robot1' and 'robot2'"),
        ({'arena.obstacles': [1.0, 1.0]}, 'must be a list of 0, 3, 6, ... numbers in [-10000'),
        ({'arena.obstacles': [1.0, 1.0, -0.1]}, 'radius -0.1'),
        ({'arena.obstacles': [0.6, 0.9, 0.1]}, "start of 'robot1' is 0.2 m from the centre"),
        ({'weights.time': 0.0, 'weights.sequence': 0.0, 'weights.gas': 0.0}, 'are all 0'),
    ],
)
def test_bad_input_gets_one_clear_sentence(changes, words):
    assert words in refused(lambda: RobotFormation.from_parameters(changes))
    with pytest.raises(InvalidProblem, match="robot 'stranger' is not among"):
        RobotFormation(starts={'stranger': RobotStart(x=1.0, y=1.0)})


@given(
    distance=st.floats(0.004, 0.3),
    way=st.floats(0.0, 6.28),
    alpha=st.floats(-3.0, 3.0),
    rate=st.floats(0.6, 6.0),
)
@settings(max_examples=25)
def test_a_short_way_leaves_the_thruster_time_to_turn(distance, way, alpha, rate):
    goal = 2.0 + distance * math.cos(way), 2.0 + distance * math.sin(way), 0.0
    short = alone((2.0, 2.0, 0.0), goal, alpha=alpha) | {'method': 'thrust_arcs'}
    problem = formation(**short, **{'limits.thruster_rate': rate, 'solver.deadline': 0.5})
    flown(problem, counted=True)


@pytest.mark.parametrize('seed', range(8))
def test_a_robot_that_drifts_comes_back(seed):
    rng, here = np.random.default_rng([seed, 9]), (2.0, 2.0, 0.0)
    way = rng.uniform(-math.pi, math.pi)
    moving = {
        'alpha': rng.uniform(-3.0, 3.0),
        'u': 0.08 * math.cos(way),
        'v': 0.08 * math.sin(way),
    }
    problem = formation(**alone(here, here, **moving), **{'method': 'thrust_arcs'})
    flown(problem, deadline=0.3, counted=True)


@pytest.mark.parametrize(('x', 'u', 'over'), [(0.6, 0.9, 0.85), (3.0, -0.9, 1.25)])
def test_a_robot_that_cannot_stop_before_the_wall_is_infeasible(x, u, over) -> None:
    moving = {'robot1.start.x': x, 'robot1.start.u': u}
    with pytest.raises(Infeasible, match=rf'cannot stop .* start\.u = {u} m/s.* {over} m nearer'):
        RobotFormation.from_parameters(moving).solve()


@pytest.mark.parametrize('changes', [{}, {'robot1.start.u': 0.01}])
def test_a_goal_that_takes_longer_than_allowed_is_infeasible(changes) -> None:
    with pytest.raises(Infeasible, match=r'solver\.longest = 3 s: at least .* s are needed'):
        RobotFormation.from_parameters({'solver.longest': 3.0, **changes}).solve()


def test_a_thruster_that_turns_too_slowly_is_named():
    slow = RobotFormation.from_parameters({'limits.thruster_rate': 0.02})
    with pytest.raises(Infeasible, match=r'takes 157 s for half a turn \(limits\.thruster_rate'):
        slow.solve(counted=True)


def test_the_reserve_for_tracking_survives_a_slow_thruster():
    slow = {'limits.thruster_rate': 0.5} | {f'robot{i}.start.alpha': 0.0 for i in (1, 2, 3)}
    problem = formation(**slow)
    solution = flown(problem)
    left = [value for name, value in solution.verification.worst.items() if 'separation' in name]
    assert min(left) >= 0.5 * problem.arena.tracking_margin


def test_penalty_is_equation_29_mended():
    """Everything is violated: walls, zones, limits of all kinds, the distance of neighbours."""
    task, rng, times = formation().task, np.random.default_rng(7), np.arange(500.0)
    task = replace(task, obstacles=np.array([[0.3, 0.2, 0.4]]))
    states, controls = rng.normal(size=(500, task.n, 7)), rng.normal(size=(500, task.n, 3))
    k, half = np.array([0.1, 0.2, 0.3, 0.4]), task.separation / 2
    largest = task.plant.mass * task.thrust, task.thruster_rate, task.plant.inertia * task.torque

    def square(margin):
        return float(np.maximum(-margin, 0.0).max() ** 2)

    delta, worst = 0.0, []
    for i, place in enumerate(np.moveaxis(states[..., :2], 1, 0)):
        f, turn, t = (controls[:, i] / largest).T
        delta += k[0] * square(np.minimum(place, task.sides - place).min(axis=1) - half)
        away = np.linalg.norm(place - task.obstacles[0, :2], axis=1)
        delta += k[0] * square(away - task.obstacles[0, 2] - half)
        delta += k[1] * square(np.minimum(1 - f, f))
        delta += k[2] * (square(1 - np.abs(t)) + square(1 - np.abs(turn)))
        for other in range(i):
            apart = np.linalg.norm(place - states[:, other, :2], axis=1)
            delta += k[3] * square(apart - task.separation)
        constraints = verification.robot_constraints(task)
        worst.append(check(constraints, times, states[:, i], controls[:, i])[0])
    whole = states.reshape(500, -1), controls.reshape(500, -1)
    pairs = check(verification.separation_constraints(task), times, *whole)[0]
    assert delta > 0.1
    assert verification.penalty(task, worst, pairs, k) == pytest.approx(delta)
    # Limits that are kept cost nothing, nor do violations within rounding, relative to each unit.
    units = dict(zip(('thrust', 'thruster_rate', 'torque'), largest, strict=True))
    units |= {'walls': 1.0, 'keep_out': 1.0}
    kept = [{name: size * unit for name, unit in units.items()} for size in (-1e-9, 0.3)]
    assert verification.penalty(task, kept, {'1-2': 0.5}, k) == 0.0


def test_added_robots_get_names_that_are_free():
    with pytest.raises(InvalidProblem, match=r'radius -0\.5 at \(1, 1\): must be in \(0, inf\) m'):
        with_number_of_robots({'arena.obstacles': [1.0, 1.0, -0.5]}, 5)
    names = with_number_of_robots({'robots': ['robot2', 'left']}, 5)['robots']
    assert names == ['robot2', 'left', 'robot1', 'robot3', 'robot4']
    # Robots without a start are measured, and no hindrance.
    made = with_number_of_robots({'robots': ['left'], 'formation.left': [0.0, 0.0, 0.0]}, 2)
    assert 'left.start.x' not in made
    assert made['formation.robot1'][:2] != [0.0, 0.0]


@settings(max_examples=15)
@given(
    number=st.integers(1, 12),
    length=st.floats(3.5, 8.0),
    width=st.floats(3.5, 8.0),
    zone=st.tuples(st.floats(1.0, 3.0), st.floats(0.5, 1.0), st.floats(0.05, 0.3)),
    yaw=st.floats(-3.0, 3.0),
)
def test_places_are_clear_of_each_other_and_of_the_arena(number, length, width, zone, yaw):
    values = {'arena.length': length, 'arena.width': width, 'arena.obstacles': list(zone)}
    values |= {'robots': ['first'], 'formation.anchor': [1.7, 2.0, yaw]}
    values |= pose('first', (0.5, 3.0, 0.0), (0.3, 0.0, 0.0))
    try:
        values |= with_number_of_robots(values, number)
    except InvalidProblem as error:
        assert 'room in the arena' in str(error)
        return
    names = values['robots']
    assert len(set(names)) == number
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    starts = np.array([[values[f'{n}.start.x'], values[f'{n}.start.y']] for n in names])
    goals = np.array([[1.7, 2.0] + turn @ values[f'formation.{n}'][:2] for n in names])
    for places in (starts, goals):
        apart = np.linalg.norm(places[:, None] - places, axis=2) + 1e3 * np.eye(number)
        assert apart.min() >= 0.6 - 1e-5
        added = places[1:]
        assert (np.minimum(added, [length, width] - added) >= 0.4 - 1e-5).all()
        away = np.linalg.norm(added - zone[:2], axis=1)
        assert (away >= zone[2] + 0.4 - 1e-5).all()


def test_where_only_the_time_for_the_check_is_left_the_deadline_ends_the_search() -> None:
    budget, problem = Budget(10.0), RobotFormation()
    search = problem.search(budget, np.random.default_rng(0), None)
    assert type(search.failure()) is Infeasible
    budget.started -= 10.0 - 5e-3
    assert type(search.failure()) is DeadlineExceeded

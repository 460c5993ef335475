# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Reference motions of robots and their thrusters' directions; motions that late robots keep."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.direct_method.virtual_arc import (
    bernstein_basis,
    bernstein_integral,
    reciprocal,
    time_derivatives,
)
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.formation.reference_motion import MotionForm, ReferenceMotion
from tdm_planner.problems.formation.thrust_direction import ThrustDirection
from tdm_planner.problems.formation.warm_start import kept_motions, LATE, turning_time
from tdm_planner.replanning import ActivePlan, FormationExecution, Mode, Observation

TASK = RobotFormation().task


FORMS = [
    MotionForm(*form)
    for form in (
        (5, 5, 0, True),
        (7, 7, 0, False),
        (9, 5, 0, True),
        (7, 5, 2, False),
        (7, 7, 3, True),
    )
]


def moving_task(seed):
    rng = np.random.default_rng(seed)
    return replace(
        TASK,
        velocity=rng.normal(0, 0.05, (3, 2)),
        acceleration=rng.normal(0, 0.02, (3, 2)),
        yaw_rate=rng.normal(0, 0.1, 3),
        yaw_acceleration=rng.normal(0, 0.05, 3),
        coast=rng.uniform(0, 2, 3),
    )


def random_parameters(model, seed):
    rng = np.random.default_rng(seed)
    x = rng.normal(0, 0.3, (3, model.size))
    x[:, : model.nb] = rng.uniform(0.6, 1.4, (3, model.nb))
    return x * model.units


def in_time(model, motion, s, derivative):
    """Positions and attitudes (n, 3) at arc s, differentiated with respect to time."""
    rates = [bernstein_basis(model.form.degree, s, d) for d in range(2)]
    speed = reciprocal([(motion.rates @ each)[:, None] for each in rates])

    def along(d):
        position = motion.position @ model.basis.basis.values(s, d)
        yaw = motion.yaw @ model.yaw_basis.basis.values(s, d)
        return np.concatenate([position, yaw[:, None]], axis=1)

    return time_derivatives([along(d) for d in range(derivative + 1)], speed)[derivative]


@given(form=st.sampled_from(FORMS), seed=st.integers(0, 1000))
@settings(max_examples=40)
def test_boundary_conditions_hold_whatever_is_varied(form, seed):
    task = moving_task(seed)
    model = ReferenceMotion(task, form)
    motion = model.unpack(random_parameters(model, seed))

    def expect(s, derivative, places, yaws, axes=slice(0, 3)):
        expected = np.concatenate([places, yaws[:, None]], axis=1)[:, axes]
        assert in_time(model, motion, s, derivative)[:, axes] == pytest.approx(expected, abs=1e-9)

    given_axes = slice(0, 3) if not model.form.vary_ends else slice(2, 3)
    rest = np.zeros((3, 2)), np.zeros(3)
    expect(0.0, 0, task.departure, task.departure_yaw)
    expect(0.0, 1, task.velocity, task.yaw_rate)
    expect(0.0, 2, task.acceleration, task.yaw_acceleration, given_axes)
    expect(1.0, 0, task.goal, task.goal_yaw)
    expect(1.0, 1, *rest)
    expect(1.0, 2, *rest, given_axes)


def test_time_along_the_arc_is_inverted():
    task = moving_task(17)
    model = ReferenceMotion(task, MotionForm(7, 5, 2))
    motion = model.unpack(random_parameters(model, 17))
    t = np.linspace(0.0, 40.0, 41)
    for robot, (rates, coast) in enumerate(zip(motion.rates, task.coast, strict=True)):
        s = model.arcs_at(motion, robot, t)
        times = bernstein_integral(rates.size - 1, s) @ rates
        last = bernstein_integral(rates.size - 1, 1.0) @ rates
        assert times == pytest.approx(np.clip(t - coast, 0.0, last), abs=1e-9)


TIMES = np.linspace(0.0, 20.0, 401)


RATE, THRUST = 1.0, 0.1


def flip(offset=0.0, turns=1):
    """Accelerate and brake `turns` times along x, passing zero at a lateral `offset`."""
    along = THRUST * np.cos(turns * np.pi * TIMES / TIMES[-1])
    return np.stack([along, np.full_like(along, offset)], axis=1)


def follow(wanted, alpha=np.nan, rate=RATE):
    return ThrustDirection(TIMES, wanted, np.zeros(TIMES.size), rate, THRUST, alpha).follow(wanted)


@given(
    seed=st.integers(0, 500),
    alpha=st.one_of(st.just(np.nan), st.floats(-3.0, 3.0)),
    rate=st.floats(0.2, 3.0),
)
@settings(max_examples=40)
def test_never_turns_faster_than_the_limit(seed, alpha, rate):
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(0, 1, (2, 4))
    s = 2 * TIMES / TIMES[-1] - 1
    wanted = THRUST * np.stack([np.polynomial.chebyshev.chebval(s, c) for c in coefficients], 1)
    yaw = 0.3 * np.sin(TIMES * rng.uniform(0.1, 0.6))
    angle, speed = ThrustDirection(TIMES, wanted, yaw, rate, THRUST, alpha).follow(wanted)
    assert np.abs(speed).max() <= rate
    steps = np.diff(TIMES) * (speed[1:] + speed[:-1]) / 2
    assert np.diff(angle) == pytest.approx(steps, abs=1e-12)
    if not np.isnan(alpha):
        assert angle[0] == alpha


def test_the_branch_survives_small_changes():
    """The direction of a turn must not change when the wanted acceleration changes a little."""
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


FORMATION = RobotFormation()
AWAY = np.array([0.008, -0.008, 0.005, 0.005, 0.01, 0.01, 0.0])


@pytest.fixture(scope='module')
def crossing() -> ActivePlan:
    return ActivePlan(FORMATION, FORMATION.solve(deadline=60.0), start=0.0)


def late(plan: ActivePlan) -> float:
    """Return an instant at which the first robot is on its last leg."""
    rate = FORMATION.limits.thruster_rate
    return plan.solution.trajectories['robot1'].duration - 0.8 * turning_time(rate)


def asked_at(
    plan: ActivePlan, at: float, asked: RobotFormation = FORMATION, **away: np.ndarray
) -> RobotFormation:
    """Return the problem `asked` from where the robots are seen then."""
    seen = {
        name: Observation(motion.sample(at).state + away.get(name, 0.0), at, Mode.FOLLOWING)
        for name, motion in plan.solution.trajectories.items()
    }
    execution = FormationExecution(FORMATION)
    return execution.problem_from(asked, execution.predict(plan, seen, at))


def test_a_robot_about_to_arrive_keeps_its_motion(crossing: ActivePlan) -> None:
    at = late(crossing)
    problem = asked_at(crossing, at, robot1=AWAY, robot3=2 * AWAY)
    new = problem.solve(deadline=60.0, warm_start=crossing.remainder(at))
    assert new.verification.ok
    old = crossing.solution.trajectories['robot1']
    kept = new.trajectories['robot1']
    assert kept.duration == pytest.approx(old.duration - at, abs=1e-6)
    times = np.linspace(0.0, kept.duration, 200)
    impulses = kept.control_integral(times), old.control_integral(times + at)
    np.testing.assert_allclose(impulses[0], impulses[1] - impulses[1][0], atol=1e-6)
    states = kept.sample(times).state, old.sample(times + at).state
    np.testing.assert_allclose(*states, atol=1e-3)
    # Another robot's deviation, with more time left, is planned from.
    away = np.abs(new.trajectories['robot3'].states[0, :2] - problem.task.start[2]).max()
    assert away < 1e-9


@pytest.mark.parametrize('push', [0.0, 0.1])
@pytest.mark.parametrize('elsewhere', [0.0, 0.1])
def test_no_motion_is_kept_of_a_robot_pushed_or_led_elsewhere(crossing, push, elsewhere) -> None:
    at, formation = late(crossing), FORMATION.formation
    x, y, turn = formation.anchor
    moved = replace(formation, anchor=[x + elsewhere, y, turn])
    asked = replace(FORMATION, formation=moved)
    away = AWAY + push * np.eye(7)[2]
    planned = crossing.solution.trajectories['robot1'].sample(at).state[:2]
    task = asked_at(crossing, at, asked, robot1=away).task
    expected = planned + AWAY[:2] if push or elsewhere else planned
    np.testing.assert_allclose(task.start[0], expected, atol=1e-9)
    for seen in (task, asked_at(crossing, at, asked, robot1=0 * AWAY).task):
        kept = kept_motions(seen, crossing.remainder(at).trajectories, LATE)
        keeps = not elsewhere and not (push and seen is task)
        assert ('robot1' in kept) == keeps


def lateral_error(wanted, yaw, alpha):
    """Largest component of the wanted acceleration across the thrust, or against it."""
    heading = alpha + yaw
    across = wanted[:, 1] * np.cos(heading) - wanted[:, 0] * np.sin(heading)
    along = wanted[:, 0] * np.cos(heading) + wanted[:, 1] * np.sin(heading)
    return float(np.hypot(across, np.minimum(along, 0.0)).max())


def test_turns_round_while_little_thrust_is_wanted_and_a_slower_thruster_errs_more():
    wanted = flip()
    angles = [follow(wanted, rate=rate)[0] for rate in (2.0, RATE, 0.5)]
    assert abs(angles[1][-1] - angles[1][0]) == pytest.approx(np.pi, abs=1e-6)
    # Half a turn takes pi s; while it is more than pi / 2 off, at most as long to either side, the
    # wanted acceleration is under sin(pi^2 / 40) F_max.
    errors = [lateral_error(wanted, 0.0, angle) for angle in angles]
    assert errors[1] < 1.3 * THRUST * np.sin(np.pi**2 / 40)
    assert errors[0] < errors[1] < errors[2]

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from mission_bags import robot_parameters
import numpy as np
from page_missions import DURATION, pendulum_mission, robot_plan, robot_states, robots_mission
import pytest
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.comparison import compare, Comparison, Entry
from tdm_sim.report.limit_entries import missed_deadlines
from tdm_sim.report.margins import MOST_PAIRS, separations
from tdm_sim.report.mission import (
    Event,
    Margin,
    Mission,
    PlanFigures,
    PlanInForce,
    Severity,
    Signals,
    Vehicle,
)

TURN = 2 * math.pi
NAMES = ('theta', 'psi', 'theta_dot', 'psi_dot')
UNITS = ('rad', 'rad', 'rad/s', 'rad/s')


def swing_up(caught_at: float = 2.1, peak: float = 0.018, disk: float = 0.9) -> Mission:
    """From hanging to upright in 2 s as planned, `caught_at` s as measured, and held."""
    times = np.linspace(0.0, DURATION, 81)
    share = times / DURATION
    states = np.stack([math.pi * (1 + share), 0.5 * share, 0 * share, 0 * share], axis=1)
    plan = Trajectory(
        times, states, np.full((81, 1), 0.014), NAMES, ('torque',), 'zero_order_hold', UNITS,
        ('N m',),
    )  # fmt: skip
    at = np.arange(-1.0, 12.0, 0.005)
    progress = np.clip(at / caught_at, 0.0, 1.0)
    theta = np.where(at >= caught_at, TURN, math.pi * (1 + 0.9 * progress))
    psi = np.where(np.isclose(at, 1.0), -disk, 0.5 * np.clip(at / DURATION, 0.0, 1.0))
    measured = np.stack([theta, psi, 0 * at, 0 * at], axis=1)
    torque = np.where(np.isclose(at, 0.5), -peak, 0.01)[:, None]
    vehicle = Vehicle(
        'pendulum',
        'pendulum',
        (PlanInForce('1', 0.0, plan),),
        states=Signals(at, measured, NAMES, UNITS),
        applied=Signals(at, torque, ('torque',), ('N m',)),
    )
    figures = PlanFigures(
        '1',
        0.0,
        DURATION,
        DURATION,
        solve_time=0.2,
        margins={'torque': Margin(0.006, 0.25, 'N m')},
        terminal_error={'theta': 2e-5},
    )
    return Mission(
        'Swing-up',
        'pendulum_swing_up',
        (vehicle,),
        (figures,),
        parameters=PendulumSwingUp().to_parameters(),
    )


def formation(**changes) -> Mission:
    mission = robots_mission(after=7.0)
    figures = PlanFigures('1', 0.0, DURATION, 1.0, cost_terms={'time': 0.1, 'gas': 0.9})
    fields = {'parameters': robot_parameters(2), 'figures': (figures,)}
    return replace(mission, **(fields | changes))


def entry(comparison: Comparison, name: str, vehicle: str = '') -> Entry:
    (found,) = [e for e in comparison.entries if (e.name, e.vehicle) == (name, vehicle)]
    return found


def test_a_swing_up_that_was_caught_and_held():
    comparison = compare(swing_up())
    duration = entry(comparison, 'time to the goal', 'pendulum')
    # the plan judged alike: within 0.05 rad of upright at pi / 2 rad/s
    assert duration.planned == pytest.approx(DURATION - 0.05 / (math.pi / DURATION), abs=2e-3)
    assert entry(comparison, 'duration of the plan', 'pendulum').planned == DURATION
    assert duration.achieved == pytest.approx(2.1)
    assert duration.achieved_at == pytest.approx(2.1)
    cost = entry(comparison, 'cost J')
    assert (cost.planned, cost.achieved) == (DURATION, pytest.approx(2.1))
    landing = entry(comparison, 'error of theta at the planned end', 'pendulum')
    assert landing.planned == 2e-5
    assert landing.achieved == pytest.approx(math.pi * (1 + 0.9 * 2.0 / 2.1) - TURN, abs=1e-9)
    torque = entry(comparison, 'margin of torque', 'pendulum')
    assert (torque.planned, torque.planned_at, torque.unit) == (0.006, 0.25, 'N m')
    assert torque.achieved == pytest.approx(0.02 - 0.018)
    assert torque.achieved_at == pytest.approx(0.5)
    assert not torque.violated
    disk = entry(comparison, 'margin of disk_angle', 'pendulum')
    assert disk.planned == pytest.approx(1.5)  # of the planned states
    assert disk.achieved == pytest.approx(2.0 - 0.9)
    assert disk.achieved_at == pytest.approx(1.0)
    assert comparison.verdict is not None
    assert comparison.verdict.reached


def test_a_violated_limit_and_a_goal_that_was_not_held():
    comparison = compare(swing_up(peak=0.025))
    assert entry(comparison, 'margin of torque', 'pendulum').violated
    assert comparison.verdict is not None
    assert not comparison.verdict.reached
    fallen = swing_up()
    (vehicle,) = fallen.vehicles
    assert vehicle.states is not None
    vehicle.states.values[-200:, 0] = 5.0
    late = compare(fallen)
    duration = entry(late, 'time to the goal', 'pendulum')
    assert duration.achieved is None
    assert duration.note == 'the goal was not held to the end'
    assert entry(late, 'cost J').achieved is None


def test_a_recording_that_ends_before_the_motion_does():
    mission = swing_up()
    (vehicle,) = mission.vehicles
    assert vehicle.states is not None
    cut = replace(vehicle, states=vehicle.states.between(-1.0, 1.0))
    comparison = compare(replace(mission, vehicles=(cut,)))
    duration = entry(comparison, 'time to the goal', 'pendulum')
    assert (duration.achieved, duration.note) == (None, 'the recording ends before')
    assert comparison.verdict is not None
    assert comparison.verdict.reasons == ()
    assert comparison.verdict.undecided.startswith('the recording ends at 1.0 s')


@pytest.mark.parametrize('end', [2.05, 2.2, 5.4, 7.0])
def test_a_recording_that_ends_before_the_goal_was_held_long_enough(end):
    mission = swing_up()
    (vehicle,) = mission.vehicles
    assert vehicle.states is not None
    cut = replace(vehicle, states=vehicle.states.between(-1.0, end))
    comparison = compare(replace(mission, vehicles=(cut,)))
    assert comparison.verdict is not None
    assert comparison.verdict.reasons == ()
    assert f'ends at {end:.1f} s' in comparison.verdict.undecided
    duration = entry(comparison, 'time to the goal', 'pendulum')
    assert (duration.achieved is None) == (end < 2.1)
    assert duration.note == ('the recording ends before' if end < 2.1 else '')


def test_robots_whose_recording_ends_before_they_held_their_places():
    mission = formation()
    cut = tuple(
        replace(robot, states=robot.states.between(-1.0, end))
        for robot, end in zip(mission.vehicles, (4.5, 5.5), strict=True)
    )
    verdict = compare(replace(mission, vehicles=cut)).verdict
    assert verdict is not None
    assert (verdict.reasons, verdict.reached) == ((), False)
    assert verdict.undecided.startswith('the recording ends at 4.5 s')
    near = np.concatenate([cut[0].states.values[:-1], cut[0].states.values[-1:] + 5.0])
    out = replace(cut[0], states=replace(cut[0].states, values=near))
    missed = compare(replace(mission, vehicles=(out, cut[1]))).verdict
    assert missed is not None
    assert 'of a wall' in missed.reasons[0]
    assert missed.undecided == ''


def replanned(mission: Mission, start: float, duration: float = DURATION) -> Mission:
    """With a second plan of every vehicle: the first one's, from `start` on and so long."""
    vehicles = []
    for vehicle in mission.vehicles:
        (first,) = vehicle.plans
        times = first.trajectory.times * duration / DURATION
        second = PlanInForce('2', start, replace(first.trajectory, times=times))
        vehicles.append(replace(vehicle, plans=(replace(first, until=start), second)))
    return replace(mission, vehicles=tuple(vehicles))


def test_a_replanned_swing_up_is_judged_against_the_plan_active_at_the_end():
    late = swing_up(caught_at=6.5)
    once = compare(late).verdict
    assert once is not None
    assert 'not upright within 3 s' in once.reasons[0]  # planned for 2 s
    twice = compare(replanned(late, 1.5, 4.0)).verdict  # planned anew for 5.5 s
    assert twice is not None
    assert twice.reached
    assert ('duration of the plan [s]', '5.500', '') in twice.rows
    sooner = compare(replanned(late, 0.5, 2.0)).verdict  # planned anew for 2.5 s
    assert sooner is not None
    assert 'not upright within 3 s' in sooner.reasons[0]


def test_limits_count_from_the_first_of_several_plans_on():
    verdict = compare(replanned(swing_up(peak=0.025), 1.5)).verdict
    assert verdict is not None
    assert verdict.reasons == ('the torque reached 0.025 N m, its limit is 0.02 N m',)


def test_a_goal_held_since_before_a_replan_is_held_since_then():
    verdict = compare(replanned(swing_up(), 8.5)).verdict  # 3.5 s before the recording ends
    assert verdict is not None
    assert verdict.reached


def test_a_plan_still_pending_when_the_recording_ends_is_not_judged():
    verdict = compare(replanned(swing_up(caught_at=6.5), 12.5)).verdict
    assert verdict is not None
    assert 'not upright within 3 s' in verdict.reasons[0]
    (vehicle,) = swing_up().vehicles
    assert vehicle.states is not None
    before = replace(vehicle, states=vehicle.states.between(-1.0, -0.1))
    assert compare(replace(swing_up(), vehicles=(before,))).verdict is None


def test_replanned_robots_are_judged_at_the_goals_of_the_plans_active_at_the_end():
    mission = replanned(formation(vehicles=robots_mission(after=10.0).vehicles), 1.0)
    first = compare(mission).verdict
    assert first is not None
    assert first.reached
    (one, *others) = mission.vehicles
    end = one.plans[1].trajectory
    away = replace(end, states=end.states + np.eye(7)[0])
    moved = replace(one, plans=(one.plans[0], replace(one.plans[1], trajectory=away)))
    missed = compare(replace(mission, vehicles=(moved, *others))).verdict
    assert missed is not None
    assert missed.reasons == (
        f'{one.name} was not in its place within 8 s of the planned arrival',
    )


def test_robots_of_which_one_was_added_later_are_compared_at_the_same_instants():
    mission = replanned(formation(), 1.0)
    one, other = mission.vehicles
    added = replace(other, plans=other.plans[1:])
    before = compare(mission).verdict
    after = compare(replace(mission, vehicles=(one, added))).verdict
    assert before is not None
    assert after is not None
    distance = [
        next(row for row in verdict.rows if row[0] == 'smallest distance [m]')[2]
        for verdict in (before, after)
    ]
    assert distance[0] == distance[1]
    assert after.reached


def test_only_what_was_measured_after_the_start_counts():
    mission = swing_up()
    (vehicle,) = mission.vehicles
    assert vehicle.applied is not None
    vehicle.applied.values[:100] = 0.5  # before the motion
    torque = entry(compare(mission), 'margin of torque', 'pendulum')
    assert torque.achieved == pytest.approx(0.02 - 0.018)


def test_tracking_errors_are_computed_where_none_were_published():
    errors = compare(swing_up(caught_at=2.0)).tracking_errors['pendulum']
    assert errors.times[0] == pytest.approx(0.0)
    assert errors.times[-1] == pytest.approx(DURATION, abs=0.01)
    expected = math.pi * (0.9 - 1.0) * errors.times / DURATION
    np.testing.assert_allclose(errors.column('theta')[:-1], expected[:-1], atol=1e-9)
    published = compare(pendulum_mission())
    rms = entry(published, 'rms error of theta', 'pendulum')
    largest = entry(published, 'largest error of psi', 'pendulum')
    assert rms.achieved == pytest.approx(0.02)
    assert largest.achieved == pytest.approx(0.01)


def test_a_formation():
    comparison = compare(formation())
    together = entry(comparison, 'time until all are at the goal')
    each = [e.achieved for e in comparison.of('duration') if e.vehicle]
    assert entry(comparison, 'duration of all plans').planned == DURATION
    each = [value for value in each if value is not None]
    # 20 mm at 0.63 m/s, 0.03 rad at 0.3 rad/s
    assert together.planned == pytest.approx(DURATION - 0.031, abs=5e-3)
    assert together.achieved == max(each)
    # within 20 mm of the goal at 0.63 m/s with an offset of 10 mm, within 0.03 rad at 0.3 rad/s
    assert each[0] == pytest.approx(DURATION, abs=0.05)
    gas = 2 * 0.5 * DURATION / 10.5  # thrust 0.5 N, two robots of 10.5 kg
    assert entry(comparison, 'cost: gas').achieved == pytest.approx(0.9 * gas, rel=0.02)
    # within the tolerances before the plans end: all terms are until they do
    assert max(each) < DURATION
    assert entry(comparison, 'cost: time').achieved == pytest.approx(0.05 * DURATION)
    assert entry(comparison, 'cost: sequence').achieved == pytest.approx(0.05 * 2.0)
    position = entry(comparison, 'error of position at the planned end', 'robot1')
    assert position.achieved == pytest.approx(0.01)
    walls = entry(comparison, 'margin of walls', 'robot1')
    assert walls.planned == pytest.approx(0.5 - 0.2)
    assert walls.achieved == pytest.approx(0.5 - 0.2)
    apart = entry(comparison, 'smallest distance of two robots')
    assert apart.planned == pytest.approx(1.0)
    assert apart.achieved == pytest.approx(1.0)
    assert entry(comparison, 'margin of separation').achieved == pytest.approx(0.6)
    assert comparison.minimum_separation == 0.4
    assert comparison.verdict is not None
    assert comparison.verdict.reached


def test_terms_of_the_cost_span_the_same_time():
    mission = formation()
    until = DURATION - 0.02  # within the tolerances, but the planned end was not recorded
    cut = tuple(
        replace(v, states=None if v.states is None else v.states.between(-1.0, until))
        for v in mission.vehicles
    )
    comparison = compare(replace(mission, vehicles=cut))
    assert entry(comparison, 'time until all are at the goal').achieved is not None
    assert entry(comparison, 'cost J').achieved is None


def coasting(thrust: float) -> Mission:
    """Return the formation, its first robot with `thrust` for a moment, coasting otherwise."""
    mission = formation()
    first, *others = mission.vehicles
    assert first.controls is not None
    values = np.zeros_like(first.controls.values)
    k = int(np.searchsorted(first.controls.times, 0.8))
    moment = slice(k, k + 10)
    values[moment, first.controls.names.index('thrust')] = thrust
    controls = replace(first.controls, values=values)
    return replace(mission, vehicles=(replace(first, applied=controls), *others))


def test_a_robot_that_coasts_is_not_at_the_limit_of_its_thrust():
    limit = float(robot_parameters(2).get('limits.thrust', 1.0))
    comparison = compare(coasting(0.6 * limit))
    thrust = entry(comparison, 'margin of thrust', 'robot1')
    assert thrust.achieved == pytest.approx(0.4 * limit)
    assert thrust.planned == pytest.approx(limit - 0.5)
    assert thrust.mark == ''
    assert not [e for e in comparison.entries if 'lower bound' in e.name]
    full = entry(compare(coasting(limit)), 'margin of thrust', 'robot1')
    assert (full.achieved, full.mark) == (pytest.approx(0.0, abs=1e-9), 'saturated')
    below = compare(coasting(-0.1))
    lower = entry(below, 'margin of thrust, lower bound', 'robot1')
    assert lower.achieved == pytest.approx(-0.1)
    assert lower.violated


def test_parameters_that_are_invalid_are_said_to_be():
    mission = formation(parameters={**robot_parameters(2), 'plant.mass': -1.0})
    comparison = compare(mission)
    assert comparison.margins['robot1'].measured is None
    assert "parameter 'plant.mass' = -1.0" in comparison.missing[0]


def test_distances_of_many_robots_are_those_that_come_closest():
    robots = []
    for number in range(24):
        plan = robot_plan(0)
        states = plan.states.copy()
        states[:, 1] += 0.01 * number**2
        robots.append(
            Vehicle(f'r{number}', 'robot', (PlanInForce('', 0.0, replace(plan, states=states)),))
        )
    planned = separations(Mission('', '', tuple(robots))).planned
    assert planned is not None
    assert len(planned.names) == MOST_PAIRS
    assert planned.column('r0 - r1') == pytest.approx(0.01)
    assert 'r0 - r23' not in planned


def test_planned_distances_follow_replans():
    first, second = robot_plan(0), robot_plan(1)
    moved = replace(first, states=first.states + np.array([0, -1.0, 0, 0, 0, 0, 0]))
    one = Vehicle('a', 'robot', (PlanInForce('', 0.0, first, 1.0), PlanInForce('', 1.0, moved)))
    other = Vehicle('b', 'robot', (PlanInForce('', 0.0, second),))
    planned = separations(Mission('', '', (one, other))).planned
    assert planned is not None
    early = planned.times < 1.0
    np.testing.assert_allclose(planned.column('a - b')[early], 1.0, atol=1e-9)
    place = robot_states(0.0, 0) - [0, 1.0, 0, 0, 0, 0, 0] - robot_states(1.0, 1)
    k = int(np.argmin(np.abs(planned.times - 1.0)))
    late = planned.column('a - b')[k + 1]
    assert late == pytest.approx(math.hypot(*place[:2]), abs=0.02)


def test_replans_refusals_deadlines_and_errors_are_counted():
    events = (
        Event(0.0, Severity.WARN, '/p/planner', 'DEADLINE: no plan within 0.5 s'),
        Event(0.1, Severity.WARN, '/p/planner', 'plan 2 is published 0.2 s after the start of'),
        Event(0.2, Severity.ERROR, '/p/tracker', 'idle'),
        Event(0.3, Severity.WARN, '/p/planner', 'NO_STATE: none'),
    )
    figures = tuple(PlanFigures(str(k), 0.2 * k, solve_time=0.3 * (k + 1)) for k in range(3))
    mission = replace(swing_up(), events=events, figures=figures, counters={'failures': 2})
    assert missed_deadlines(mission) == 4  # two plans took 0.6 s and 0.9 s of 0.5 s
    comparison = compare(mission)
    assert entry(comparison, 'replans').achieved == 2.0
    assert entry(comparison, 'requests without a plan').achieved == 2.0
    assert entry(comparison, 'missed deadlines').achieved == 4.0
    assert entry(comparison, 'errors reported by nodes').achieved == 1.0
    assert entry(comparison, 'time to solve').achieved == pytest.approx(0.9)
    assert entry(comparison, 'time to solve').planned == 0.5


def test_errors_of_nodes_that_wait_for_each_other_are_not_counted():
    early = (
        Event(-3.0, Severity.ERROR, '/p/tracker', 'idle: no state has been received yet'),
        Event(-1.0, Severity.OK, '/p/tracker', 'waiting'),
    )
    mission = replace(swing_up(), events=early)
    assert entry(compare(mission), 'errors reported by nodes').achieved == 0.0
    unsettled = replace(mission, events=early[:1])  # nothing says that it was got over
    assert entry(compare(unsettled), 'errors reported by nodes').achieved == 1.0
    (vehicle,) = mission.vehicles
    planless = replace(mission, vehicles=(replace(vehicle, plans=()),))
    assert entry(compare(planless), 'errors reported by nodes').achieved == 1.0


def test_missing_samples_are_no_margins():
    mission = swing_up()
    (vehicle,) = mission.vehicles
    assert vehicle.states is not None
    vehicle.states.values[::3, 1] = np.nan
    comparison = compare(mission)
    disk = entry(comparison, 'margin of disk_angle', 'pendulum')
    assert disk.achieved is not None
    assert math.isfinite(disk.achieved)
    assert entry(comparison, 'time to the goal', 'pendulum').achieved == pytest.approx(2.1)


@pytest.mark.parametrize('part', ['states', 'applied', 'plans'])
def test_every_part_may_be_missing(part: str):
    for mission in (swing_up(), formation()):
        empty: dict[str, Any] = {part: () if part == 'plans' else None}
        vehicles = tuple(replace(v, **empty) for v in mission.vehicles)
        comparison = compare(replace(mission, vehicles=vehicles, figures=()))
        assert all(e.achieved is None or math.isfinite(e.achieved) for e in comparison.entries)
        assert comparison.verdict is None or part == 'applied'

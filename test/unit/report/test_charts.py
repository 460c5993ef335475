# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Charts, animation and page of a report: what was planned and measured, complete, no markup."""

import base64
from dataclasses import replace
import hashlib
import itertools
import json
from pathlib import Path
import re

from hypothesis import given, settings
from hypothesis import strategies as st
import missions
from missions import DURATION, pendulum_mission, pendulum_states, robots_mission, unpacked
import numpy as np
import pytest
from tdm_planner.drawing import Box, Line, points_of, way_of
from tdm_planner.exceptions import InvalidProblem
from tdm_sim.report.animation import measured_frames, planned_frames
from tdm_sim.report.charts import Curve, mission_charts, Panel
from tdm_sim.report.comparison import Comparison, Entry
from tdm_sim.report.mission import Mission
from tdm_sim.report.page import report_page, write_report
from tdm_sim.report.tables import summary_table

MINUS = '\N{MINUS SIGN}'


def panels(mission: Mission, key: str) -> tuple[Panel, ...]:
    (chart,) = (c for c in mission_charts(mission) if c.key == key)
    return chart.panels


def curves(panel: Panel, kind: str) -> list[Curve]:
    return [curve for curve in panel.curves if curve.kind == kind]


def test_poses_planned_and_measured() -> None:
    """Plans are held before and after, with controls off; gaps of measurements stay gaps."""
    (vehicle,) = pendulum_mission().vehicles
    at = np.array([-1.0, 0.0, 0.5, DURATION, 3.0])
    states, controls = planned_frames(vehicle, at) or ({}, {})
    expected = pendulum_states(np.clip(at, 0.0, DURATION))
    assert states['theta'] == pytest.approx(expected[:, 0], abs=1e-9)
    assert controls['torque'].tolist() == [0.0, 0.014, 0.014, -0.014, 0.0]
    (again,) = missions.replanned(pendulum_mission(), 0.9).vehicles
    states, _ = planned_frames(again, np.array([0.8, 0.9, 1.0])) or ({}, {})
    expected = pendulum_states(np.array([0.8, 0.0, 0.1]))[:, 0]
    assert states['theta'] == pytest.approx(expected, abs=1e-9)
    measured = vehicle.states
    measured.columns['theta'][(measured.times > 0.5) & (measured.times < 1.0)] = np.nan
    at = np.array([-2.0, 0.3, 0.75, 1.3, 5.0])
    states, _ = measured_frames(vehicle, at) or ({}, {})
    assert np.isnan(states['theta']).tolist() == [True, False, True, False, True]
    assert states['theta'][1] == pytest.approx(pendulum_states(0.3)[0] + 0.02, abs=1e-6)


def test_every_state_and_control_planned_and_measured_with_limits() -> None:
    for mission in (pendulum_mission(), robots_mission()):
        plan = mission.vehicles[0].plans[0].trajectory
        names = [*plan.state_names, *plan.control_names]
        shown = [*panels(mission, 'states'), *panels(mission, 'controls')]
        assert [panel.title for panel in shown] == names
        for panel, kind in itertools.product(shown, ('planned', 'measured')):
            assert len(curves(panel, kind)) == len(mission.vehicles)
    # of the robots: within walls, half the smallest distance away
    limits = {panel.title: panel.limits for panel in shown}
    assert (limits['x'], limits['y']) == (pytest.approx((0.2, 3.8)), pytest.approx((0.2, 2.8)))
    assert (limits['thrust'], limits['yaw']) == ((0.0, 1.0), ())
    (torque,) = panels(pendulum_mission(), 'controls')
    assert curves(torque, 'planned')[0].held
    assert (torque.limits, torque.unit) == ((-0.02, 0.02), 'N m')
    assert torque.switches == pytest.approx([0.8])
    one = pendulum_mission()
    (torque,) = panels(replace(one, vehicles=one.vehicles * 2), 'controls')
    assert torque.switches == ()  # of several they would hide the curves
    at = curves(torque, 'planned')[0].times[:-1]
    assert (np.diff(at) > 1e-9).all()
    assert np.abs(at - 0.8).min() < 1e-12
    (planned,) = curves(panels(pendulum_mission(), 'states')[0], 'planned')
    known = np.isfinite(planned.values)
    expected = pendulum_states(planned.times[known])[:, 0]
    assert planned.values[known] == pytest.approx(expected, abs=1e-9)
    # as long as the plan was followed
    panel = panels(missions.replanned(pendulum_mission(), 0.7), 'states')[0]
    (planned,) = curves(panel, 'planned')
    gaps = np.flatnonzero(np.isnan(planned.values))
    assert planned.times[[0, gaps[0] - 1, *gaps]] == pytest.approx([0.0, 0.7, 0.7, 0.7 + DURATION])
    assert panel.switches == pytest.approx([1.5])  # of the second


def test_any_plant_is_shown_by_its_drawing() -> None:
    x, turn = np.array([0.0, 2.0]), np.array([0.0, np.pi / 2])
    corners = points_of(Box((x, 0.0, 1.0), (0.2, 0.1, 0.4), turn), 2)
    assert corners.shape == (2, 16, 3)
    along = itertools.pairwise(map(tuple, corners[0].round(9).tolist()))
    assert len({frozenset(edge) for edge in along if edge[0] != edge[1]}) == 12
    np.testing.assert_allclose(corners.min(axis=1)[:, [0, 2]], [[-0.1, 0.8], [1.95, 0.8]])
    np.testing.assert_allclose(corners.max(axis=1)[:, 0], [0.1, 2.05])
    line = Line(((x, 0.0, 1.0), (x, 0.0, 0.0)))
    assert points_of(line, 2)[1].tolist() == [[2.0, 0.0, 1.0], [2.0, 0.0, 0.0]]
    assert way_of(line, 2).tolist() == [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    flat = Box((3.0, np.array([0.0, 1.0])), (2.0, 1.0), turn=0.3)
    assert points_of(flat, 2).shape == (2, 5, 2)
    assert way_of(flat, 2).tolist() == [[3.0, 0.0], [3.0, 1.0]]


def test_distances_of_the_closest_pairs() -> None:
    mission = robots_mission(names=[f'r{k}' for k in range(24)], rate=20.0)
    (chart,) = (c for c in mission_charts(mission) if c.key == 'distances')
    (panel,) = chart.panels
    assert panel.limits == (missions.ARENA_PARAMETERS['arena.minimum_separation'],)
    series = {curve.series for curve in panel.curves}
    assert len(series) == 6
    assert series < {f'r{k} - r{k + 1}' for k in range(23)}  # neighbours, 1 m apart
    assert 'of 276 pairs' in chart.note
    for nearest in curves(panel, 'planned'):
        assert nearest.values == pytest.approx(np.ones(nearest.values.size))


@settings(max_examples=40)
@given(st.integers(0, 3000), st.integers(10, 400), st.integers(0, 2**31))
def test_thinning_keeps_extremes_ends_and_gaps(n: int, most: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=n)
    values[rng.random(n) < 0.1] = np.nan
    kept = Curve('measured', np.arange(float(n)), values, 0).decimated(most).times.astype(int)
    assert (np.diff(kept) > 0).all()
    assert kept.size <= most
    if n:
        assert (kept[0], kept[-1]) == (0, n - 1)
    if np.isfinite(values).any():
        assert np.nanmin(values[kept]) == np.nanmin(values)
        assert np.nanmax(values[kept]) == np.nanmax(values)


@pytest.mark.parametrize('make', [pendulum_mission, robots_mission])
@pytest.mark.parametrize('measured', [True, False])
def test_self_contained(make, measured: bool) -> None:
    page = report_page(make(measured=measured))
    parts = missions.Parts(page)
    addresses = [a[key] for _, a in parts.elements for key in ('src', 'href') if key in a]
    assert addresses == ['data:,']
    assert not re.search(r'url\(\s*["\']?https?:', page)
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)[0]
    assert policy.startswith("default-src 'none'")
    scripts = [script for attributes, script in parts.scripts if 'type' not in attributes]
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_size_stays_below_the_limit_and_peaks_survive_thinning(tmp_path: Path) -> None:
    names = [f'robot{k}' for k in range(16)]
    mission = robots_mission(names=names, rate=200.0, after=58.0)
    mission.vehicles[0].states.columns['x'][1_234] = 3.9
    file = tmp_path / 'report.html'
    write_report(mission, file)
    assert file.stat().st_size < 8_000_000
    scripts = missions.Parts(file.read_text()).scripts
    (data,) = [script for words, script in scripts if words.get('id') == 'report-data']
    (chart,) = [chart for chart in json.loads(data)['charts'] if chart['key'] == 'states']
    measured = next(t for t in chart['data'] if t['meta']['kind'] == 'measured')
    y = unpacked(measured['y'])
    assert y.max() == np.float32(3.9)
    assert y.size < 4000
    with pytest.raises(InvalidProblem, match='cannot be written'):
        write_report(mission, tmp_path)


def test_a_mission_of_which_nothing_is_known_has_a_page() -> None:
    for mission in (Mission('t', ()), Mission('t', (), missing=('x',))):
        assert '<h1>t</h1>' in report_page(mission)


def test_the_worst_of_all_robots_violations_and_saturation_stand_out() -> None:
    entries = (
        Entry('margin', 'margin of thrust', 'N', 0.2, 0.1, 1.0, 2.0, vehicle='a'),
        Entry('margin', 'margin of thrust', 'N', 0.1, 0.3, 3.0, 4.0, vehicle='b'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, -0.2, vehicle='a'),
        Entry('landing', 'error of yaw at the planned end', 'rad', 0.0, 0.1, vehicle='b'),
        Entry('duration', 'time to the goal', 's', 2.0, 3.0, vehicle='a'),
        Entry('duration', 'time to the goal', 's', 4.0, vehicle='b', note='not held'),
        Entry('margin', 'margin of torque', 'N m', 0.1, -0.02, 1.0, 1.5),
        Entry('margin', 'margin of walls', 'm', 0.1, 0.0, 1.0, 1.5, mark='saturated'),
    )
    table = summary_table(robots_mission(), Comparison(entries))
    for row in (
        ['thrust [N]a', '0.1 at 3.00 s', '0.1 at 2.00 s'],
        ['error of yaw [rad]a', '0', f'{MINUS}0.2'],
        ['time to the goal [s]b, not held', '4', ''],
        ['walls [m]', '0.1 at 1.00 s', '0 at 1.50 s saturated'],
    ):
        assert row in missions.Parts(table).rows
    assert re.findall('<td class="bad">([^ ]*)', table) == [f'{MINUS}0.02']

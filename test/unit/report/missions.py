# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Missions in closed form, as a reader returns them, that tests of the report read or show.

The pendulum's angles turn evenly and each robot goes straight on while it turns evenly, for
`DURATION` s; recordings.py has the messages of such missions.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
from tdm_planner.plant_kind import PENDULUM, ROBOT
from tdm_planner.plant_views import PendulumView, RobotView
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.mission import (
    Event,
    FollowedPlan,
    Mission,
    PlanFigures,
    Severity,
    Signals,
    Vehicle,
)

DURATION = 2.0

PENDULUM_PARAMETERS = {
    'plant.arm_length': 0.1,
    'plant.com_distance': 0.06,
    'limits.torque': 0.02,
    'limits.disk_angle': 1.5,
}
ARENA_PARAMETERS = {
    'arena.length': 4.0,
    'arena.width': 3.0,
    'arena.minimum_separation': 0.4,
    'arena.obstacles': [2.0, 0.6, 0.25],
    'limits.thrust': 1.0,
    'limits.torque': 0.02,
    'limits.thruster_rate': 2.0,
}
EVIL = (  # strings that would do something if they could
    '</script><script>window.hacked=1</script>',
    '<img src=x onerror="window.hacked=2">',
    """'"><svg/onload=window.hacked=3>""",
    '<a href="javascript:window.hacked=4">x</a>{{data}}<!--',
)
# Of a single robot, so that its place fits into the arena.
ALONE = {
    'robots': ['robot1'],
    'robot1.start.x': 0.5,
    'robot1.start.y': 2.0,
    'formation.anchor': [0.0, 0.0, 0.0],
    'formation.robot1': [1.0, 2.0, 0.0],
}


def pendulum_states(t: Any) -> Any:
    """Angles that turn evenly, and their rates, (n, 4)."""
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    return np.stack([np.pi - 1.3 * t, 0.4 * t, -1.3 * one, 0.4 * one], axis=-1)


def robot_states(t: Any, number: int) -> Any:
    """Return a straight way with an even turn, (n, 7)."""
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    ways = [0.5 + 0.6 * t, 0.5 + number + 0.2 * t, 0.6 * one, 0.2 * one]
    return np.stack([*ways, 0.3 * t, 0.3 * one, (0.5 + number) * one], axis=-1)


def robot_parameters(count: int) -> dict[str, Any]:
    """Return the parameters of robots that go as `robot_states` has it."""
    values: dict[str, Any] = {'robots': [f'robot{k + 1}' for k in range(count)]}
    values['formation.anchor'] = [0.0, 0.0, 0.0]
    for k, name in enumerate(values['robots']):
        start, end = robot_states(0.0, k).tolist(), robot_states(DURATION, k).tolist()
        values |= {f'{name}.start.x': start[0], f'{name}.start.y': start[1]}
        values[f'formation.{name}'] = [end[0], end[1], end[4]]
    return RobotFormation.from_parameters(values).to_parameters()


def pendulum_plan() -> Trajectory:
    times = np.linspace(0.0, DURATION, 41)
    controls = np.where(times < 0.8, 0.014, -0.014)[:, None]
    return Trajectory.of(PENDULUM, times, pendulum_states(times), controls)


def robot_plan(number: int) -> Trajectory:
    times = np.linspace(0.0, DURATION, 41)
    controls = np.tile([0.5, 0.125, 0.001], (times.size, 1))
    return Trajectory.of(ROBOT, times, robot_states(times, number), controls, 'linear')


def pendulum_mission(measured: bool = True, **changes: Any) -> Mission:
    plan = pendulum_plan()
    found: dict[str, Signals] = {}
    if measured:
        at = np.arange(-1.0, 4.0, 0.01)
        moving = np.clip(at, 0.0, DURATION)
        errors = np.tile([0.02, -0.01, 0.0, 0.0], (at.size, 1))
        states = pendulum_states(moving) + errors
        kinds = {'names': plan.state_names, 'units': PENDULUM.state_units}
        found = {
            'states': Signals(at, states, **kinds),
            'tracking_error': Signals(at, errors, **kinds),
        }
        applied = Signals(at, plan.sample(moving).control, ('torque',), ('N m',))
        found['commands'] = found['applied'] = applied
    view = PendulumView(problem=PendulumSwingUp.from_parameters(PENDULUM_PARAMETERS))
    events = (
        Event(-0.5, Severity.OK, '/pendulum/planner', 'plan 1 active'),
        Event(1.25, Severity.WARN, '/pendulum/tracker', 'late by 3 ms'),
    )
    plain = Mission(
        'Swing-up',
        'pendulum_swing_up',
        (Vehicle('pendulum', view, (FollowedPlan(plan, 0.0),), **found),),
        figures=(PlanFigures(0.0, 2.0, summary='upright after 2 s'),),
        events=events,
        parameters=PENDULUM_PARAMETERS,
        source='/bags/one',
        recorded_at=1.7e9,
    )
    return replace(plain, **changes)


def robots_mission(
    names: Sequence[str] = ('robot1', 'robot2'),
    measured: bool = True,
    rate: float = 100.0,
    after: float = 1.0,
    given: Any = ARENA_PARAMETERS | ALONE,
    **changes: Any,
) -> Mission:
    vehicles = []
    view = RobotView(problem=RobotFormation.from_parameters(given))
    for number, name in enumerate(names):
        plan = robot_plan(number)
        found: dict[str, Signals] = {}
        if measured:
            at = np.arange(0.0, DURATION + after, 1.0 / rate)
            moving = np.clip(at, 0.0, DURATION)
            values = robot_states(moving, number) + 0.01 * np.eye(7)[0]
            states = Signals(at, values, ROBOT.state_names, ('m', 'm', *[''] * 5))
            applied = Signals(at, plan.sample(moving).control, ROBOT.control_names, ('N', '', ''))
            found = {'states': states, 'applied': applied, 'tracking_error': states}
        vehicles.append(Vehicle(name, view, (FollowedPlan(plan, 0.0),), **found))
    plain = Mission('Formation', 'robot_formation', tuple(vehicles), parameters=ARENA_PARAMETERS)
    return replace(plain, **changes)


def formation_mission(**changes: Any) -> Mission:
    """Return one of two robots in an arena that both fit into."""
    given = robot_parameters(2)
    return robots_mission(given=given, **({'parameters': given} | changes))


def unpacked(data: dict[str, str]) -> Any:
    """Return numbers of a page as the page reads them."""
    return np.frombuffer(base64.b64decode(data['bdata']), dtype='<f4')


class Parts(HTMLParser):
    """Elements of a page, its scripts with their attributes, other texts, and cells of tables."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.texts: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag == 'script':
            self.scripts.append((dict(attrs), ''))
        elif tag == 'tr':
            self.rows.append([])
        elif tag in ('td', 'th'):
            self.rows[-1].append('')

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == 'script':  # what HTMLParser is within
            attributes, text = self.scripts[-1]
            self.scripts[-1] = attributes, text + data
            return
        self.texts.append(data)
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data

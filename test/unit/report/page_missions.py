# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Missions made by hand, whose motions are known in closed form."""

from __future__ import annotations

import numpy as np
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.mission import (
    Event,
    Mission,
    PlanFigures,
    PlanInForce,
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
ROBOT_STATES = ('x', 'y', 'u', 'v', 'yaw', 'omega', 'alpha')
ROBOT_CONTROLS = ('thrust', 'thruster_rate', 'torque')


def pendulum_states(t):
    """Angles that turn evenly, and their rates, (n, 4)."""
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    return np.stack([np.pi - 1.3 * t, 0.4 * t, -1.3 * one, 0.4 * one], axis=-1)


def robot_states(t, number):
    """Return a straight way with an even turn, (n, 7)."""
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    columns = [
        0.5 + 0.6 * t,
        0.5 + number + 0.2 * t,
        0.6 * one,
        0.2 * one,
        0.3 * t,
        0.3 * one,
        (0.5 + number) * one,
    ]
    return np.stack(columns, axis=-1)


def pendulum_plan(interpolation='zero_order_hold'):
    times = np.linspace(0.0, DURATION, 41)
    torque = np.where(times < 0.8, 0.014, -0.014)[:, None]
    return Trajectory(
        times=times,
        states=pendulum_states(times),
        controls=torque,
        state_names=('theta', 'psi', 'theta_dot', 'psi_dot'),
        control_names=('torque',),
        interpolation=interpolation,
        state_units=('rad', 'rad', 'rad/s', 'rad/s'),
        control_units=('N m',),
    )


def pendulum_mission(measured=True, **changes):
    plan = pendulum_plan()
    states = applied = error = None
    if measured:
        at = np.arange(-1.0, 4.0, 0.01)
        moving = np.clip(at, 0.0, DURATION)
        offset = np.array([0.02, -0.01, 0.0, 0.0])
        states = Signals(at, pendulum_states(moving) + offset, plan.state_names, plan.state_units)
        applied = Signals(at, plan.sample(moving).control, plan.control_names, ('N m',))
        error = Signals(at, np.tile(offset, (at.size, 1)), plan.state_names, plan.state_units)
    vehicle = Vehicle(
        'pendulum',
        'pendulum',
        (PlanInForce('1', 0.0, plan),),
        states=states,
        commands=applied,
        applied=applied,
        tracking_error=error,
    )
    fields = {
        'title': 'Swing-up',
        'problem': 'pendulum_swing_up',
        'vehicles': (vehicle,),
        'figures': (PlanFigures('1', 0.0, DURATION, 2.0, summary='upright after 2 s'),),
        'events': (
            Event(-0.5, Severity.OK, '/pendulum/planner', 'plan 1 in force'),
            Event(1.25, Severity.WARN, '/pendulum/tracker', 'late by 3 ms'),
        ),
        'parameters': PENDULUM_PARAMETERS,
        'source': '/bags/one',
        'recorded_at': 1.7e9,
    }
    return Mission(**(fields | changes))


def robot_plan(number):
    times = np.linspace(0.0, DURATION, 41)
    controls = np.zeros((times.size, 3))
    controls[:, 0] = 0.5
    return Trajectory(
        times=times,
        states=robot_states(times, number),
        controls=controls,
        state_names=ROBOT_STATES,
        control_names=ROBOT_CONTROLS,
        interpolation='linear',
    )


def robots_mission(names=('robot1', 'robot2'), measured=True, rate=100.0, after=1.0, **changes):
    vehicles = []
    for number, name in enumerate(names):
        plan = robot_plan(number)
        states = applied = None
        if measured:
            at = np.arange(0.0, DURATION + after, 1.0 / rate)
            moving = np.clip(at, 0.0, DURATION)
            values = robot_states(moving, number)
            values[:, 0] += 0.01
            states = Signals(at, values, ROBOT_STATES, ('m', 'm', *[''] * 5))
            applied = Signals(at, plan.sample(moving).control, ROBOT_CONTROLS, ('N', '', ''))
        vehicles.append(
            Vehicle(
                name,
                'robot',
                (PlanInForce('1', 0.0, plan),),
                states=states,
                applied=applied,
                tracking_error=states,
            )
        )
    fields = {
        'title': 'Formation',
        'problem': 'robot_formation',
        'vehicles': tuple(vehicles),
        'parameters': ARENA_PARAMETERS,
    }
    return Mission(**(fields | changes))

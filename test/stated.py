# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Problems stated for tests, and `changed`, which makes another of one: functions by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar
from unittest.mock import create_autospec
import warnings

import pytest
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import group, parameter, POSITIVE
from tdm_planner.problems import DirectProblem, SolverParameters


@dataclass(frozen=True)
class Cart(DirectProblem):
    """Least effort over a fixed time: the optimum is the cubic, J = 12 x^2/t_f^3."""

    name: ClassVar[str] = 'cart'
    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('m/s^2',)
    start: float = parameter(1.0, 'position', unit='m')
    time: float = parameter(2.0, 'time', unit='s', allowed=POSITIVE)
    limit: float = parameter(10.0, 'largest acceleration', unit='m/s^2')
    solver: SolverParameters = group(SolverParameters)

    def outputs(self):
        return {'x': Output((self.start, 0.0), (0.0, 0.0), free=3)}

    def duration(self):
        return Duration(self.time, fixed=True)

    def invert(self, y, z):
        return y['x'][:2], y['x'][2:]

    def derivative(self, x, u):
        return x[1], u[0]

    def margins(self, t, x, u):
        return {'force': 1.0 - (u[0] / self.limit) ** 2}

    def running_cost(self, t, x, u):
        return u[0] ** 2


@dataclass(frozen=True)
class Quickest(DirectProblem):
    """In least time."""

    guess = 3.0

    def duration(self):
        return Duration(guess=self.guess)

    def final_cost(self, t, x):
        return t


@dataclass(frozen=True)
class Car(DirectProblem):
    """A car with drag, past a pole, in minimum time."""

    state_names, state_units = ('x', 'y', 'vx', 'vy'), ('m', 'm', 'm/s', 'm/s')
    control_names, control_units = ('ax', 'ay'), ('m/s^2', 'm/s^2')
    drag: float = parameter(0.1, 'drag', unit='1/m')
    limit: float = parameter(2.0, 'largest acceleration', unit='m/s^2')
    start: float = parameter(-2.0, 'where it starts', unit='m')

    def outputs(self):
        x, y = ((self.start, 0.0), (2.0, 0.0)), ((0.1, 0.0), (0.0, 0.0))
        return {'x': Output(*x, free=4), 'y': Output(*y, free=4)}

    def duration(self):
        return Duration(guess=4.0)

    def invert(self, y, z):
        (x, vx, ax), (y_, vy, ay) = y['x'], y['y']
        return (x, y_, vx, vy), (ax + self.drag * vx, ay + self.drag * vy)

    def derivative(self, x, u):
        return x[2], x[3], u[0] - self.drag * x[2], u[1] - self.drag * x[3]

    def margins(self, t, x, u):
        return {'pole': x[0] ** 2 + x[1] ** 2 - 0.25}

    def control_limits(self):
        return {'ax': (-self.limit, self.limit), 'ay': (-self.limit, self.limit)}

    def final_cost(self, t, x):
        return t


@dataclass(frozen=True)
class Start:
    x: float = parameter(-2.0, 'place', unit='m')
    vx: float = parameter(0.0, 'speed', unit='m/s')
    yaw: float = parameter(0.0, 'heading', unit='rad')
    way: float = parameter(0.0, 'way gone', unit='m')
    load: float = parameter(7.0, 'no state', unit='kg')


@dataclass(frozen=True)
class Driven(DirectProblem):
    """A car on a line that turns on the spot; `begin` is where its motion begins."""

    state_names, state_units = ('x', 'vx', 'yaw', 'way'), ('m', 'm/s', 'rad', 'm')
    control_names, control_units = ('ax', 'turn'), ('m/s^2', 'rad/s')
    end = 0.0, 0.0
    start: Start = group(Start)

    def begin(self):
        return self.start

    def outputs(self):
        s = self.begin()
        x = Output(start=(s.x, s.vx), end=self.end, free=2)
        return {'x': x, 'yaw': Output(start=(s.yaw,), end=(0.0,), free=2)}

    def integrated(self):
        return {'way': Integrated(self.begin().way)}

    def duration(self):
        return Duration(guess=3.0, fixed=True)

    def invert(self, y, z):
        return (y['x'][0], y['x'][1], y['yaw'][0], z['way']), (y['x'][2], y['yaw'][1])

    def derivative(self, x, u):
        return x[1], u[0], u[1], x[1]

    def running_cost(self, t, x, u):
        return u[0] ** 2 + u[1] ** 2


def changed(of: type, **change: Any) -> Any:
    """
    Return the class `Changed`, whose functions and names are those of another or given.

    States and controls may be given with their units, `states={'x': 'm'}`.
    """
    for kind in ('state', 'control'):
        if units := change.pop(f'{kind}s', None):
            change |= {f'{kind}_names': tuple(units), f'{kind}_units': tuple(units.values())}
    return type('Changed', (of,), change)


def forced(force: Callable[..., Any]) -> dict[str, Any]:
    """Return how a cart moves on which another force acts, x'' = u + `force`(x, x')."""
    return {
        'invert': lambda s, y, z: (y['x'][:2], (y['x'][2] - force(*y['x'][:2]),)),
        'derivative': lambda s, x, u: (x[1], u[0] + force(x[0], x[1])),
    }


def noted(patch: pytest.MonkeyPatch, of: type, name: str) -> Any:
    """Leave a method as it is; return the mock that notes its calls."""
    method = getattr(of, name)
    patch.setattr(of, name, create_autospec(method, side_effect=method))
    return getattr(of, name)


LONG = SolverParameters(deadline=60.0)
# A cart moved by 1 m in least time: 2 s.
QUICKEST = {
    'outputs': lambda self: {'x': Output((0.0, 0.0), (1.0, 0.0), free=2)},
    'duration': lambda self: Duration(3.0),
    'margins': lambda self, t, x, u: {'force': 1.0 - u[0], 'brake': 1.0 + u[0]},
    'final_cost': lambda self, t, x: t,
    'running_cost': DirectProblem.running_cost,
}


def solve(solver: SolverParameters = LONG, **change: Any) -> Any:
    """Solve a cart changed in this way; nothing is printed by numpy."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        return changed(Cart, **change)(solver=solver).solve()


def refused(make: Callable[[], Any], length: int = 300) -> str:
    """Return the one clear sentence of a refusal; nothing is printed by numpy on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(InvalidProblem) as caught:
            make()
    message = str(caught.value)
    assert '\n' not in message
    assert len(message) < length
    return message

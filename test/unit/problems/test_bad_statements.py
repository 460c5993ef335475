# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes in the statement of a problem: one sentence that names the function, and a way out."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
import pytest
from random_statements import outcome_of, random_statements
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.drawing import Disc
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.parameters import parameter, Validated
from tdm_planner.problem_check import check_problem
from tdm_planner.problems import DirectProblem, DirectSolverParameters, SolverParameters


@dataclass(frozen=True)
class Car(DirectProblem, Validated):
    """A car with drag, past a pole, in minimum time."""

    state_names, state_units = ('x', 'y', 'vx', 'vy'), ('m', 'm', 'm/s', 'm/s')
    control_names, control_units = ('ax', 'ay'), ('m/s^2', 'm/s^2')

    drag: float = parameter(0.1, 'drag', unit='1/m')
    limit: float = parameter(2.0, 'largest acceleration', unit='m/s^2')
    start: float = parameter(-2.0, 'where it starts', unit='m')

    def outputs(self):
        ends = ((self.start, 0.0), (2.0, 0.0)), ((0.1, 0.0), (0.0, 0.0))
        return {n: Output(*both, free=4) for n, both in zip('xy', ends, strict=True)}

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


def changed(**change: Any) -> Any:
    return type('Changed', (Car,), change)


def by_math(self, t, x, u):
    return {'pole': math.sqrt(x[0] ** 2 + x[1] ** 2) - 0.5}


def by_if(self, t, x, u):
    return {'pole': x[0] - 1.0 if x[0] > 0.0 else x[1]}


def by_hand(self, t, x, u):
    return {'pole': min(x[0] ** 2, 4.0) - 5.0}


def along_the_path(self, y, z):
    (x, vx, ax), (y_, vy, ay) = y['x'], y['y']
    push = (vx * ax + vy * ay) / np.hypot(vx, vy)
    return (x, y_, vx, vy), (push, ay)


def jerky(self, t, x):
    return t + np.where(x[0] > 0.0, 1.0, 0.0)


BAD: dict[str, tuple[dict[str, Any], list[str]]] = {
    'math': ({'margins': by_math}, ['margins of Changed', 'TypeError', 'np.sqrt(x)']),
    'if': ({'margins': by_if}, ['margins of Changed', 'ValueError', 'np.where']),
    'min': ({'margins': by_hand}, ['margins of Changed', 'ValueError', 'np.minimum']),
    'singular at rest': (
        {'invert': along_the_path},
        ["invert gives control 'ax' = nan at node 0"],
    ),
    'a goal outside a limit': (
        {'margins': lambda s, t, x, u: {'wall': 1.5 - x[0]}},
        ["the end violates the limit 'wall' by 0.5"],
    ),
    'a constant limit': ({'margins': lambda s, t, x, u: {'wall': 1.0}}, ["'wall'", 'remove it']),
    'a jump': ({'final_cost': jerky}, ['final_cost jumps by 1', 'np.tanh']),
    'limits of no control': (
        {'control_limits': lambda s: {'force': (-1.0, 1.0)}},
        ["control_limits names 'force'", 'ax, ay'],
    ),
    'limits upside down': (
        {'control_limits': lambda s: {'ax': (1.0, -1.0)}},
        ["control_limits gives 'ax'", 'lowest'],
    ),
    'a reserve of no limit': ({'reserve': {'speed': 0.1}}, ["reserve names 'speed'", 'pole']),
    'a reserve of all': ({'reserve': {'ax': 1.0}}, ["reserve gives 'ax' = 1"]),
    'a guess of no output': (
        {'first_guess': lambda s, at: {'z': at}},
        ["first_guess names 'z'", 'x, y'],
    ),
}


@pytest.mark.parametrize(('change', 'words'), BAD.values(), ids=BAD)
def test_a_mistake_is_one_sentence(change, words):
    with pytest.raises(InvalidProblem) as caught:
        changed(**change)().solve()
    message = str(caught.value)
    assert '\n' not in message
    assert len(message) < 350
    for word in words:
        assert word in message


def scalar_math(self, t, x, u):
    x0 = np.asarray(x[0])
    return {'pole': np.vectorize(lambda value: math.sqrt(value**2 + 1.0))(x0) - 0.5}


def test_what_only_numpy_can_compute():
    """Refused with the line, or traced to the same numbers."""
    made = changed(
        margins=lambda s, t, x, u: {'pole': np.interp(x[0], [-2.0, 0.0, 2.0], [1.0, 0.1, 1.0])}
    )
    assert made().solve().verification.ok
    with pytest.raises(InvalidProblem) as caught:
        changed(margins=scalar_math)().solve()
    for word in ('margins of Changed cannot be traced', 'math.sqrt', 'use numpy'):
        assert word in str(caught.value)


def test_a_number_that_decides_is_kept_as_a_number():
    """`if` and math on a parameter do not stop the trace; another value is traced anew."""

    def margins(self, t, x, u):
        side = 1.0 if self.drag > 0.05 else -1.0
        return {'side': side * x[1] + math.sqrt(self.limit)}

    made = changed(margins=margins)
    least = []
    for drag in (0.1, 0.01):
        plan = made(drag=drag).solve()
        y = plan.trajectory.states[:, 1]
        side = 1.0 if drag > 0.05 else -1.0
        least.append(float((side * y + math.sqrt(2.0)).min()))
        assert plan.verification.ok
        assert plan.verification.worst['side'] == pytest.approx(least[-1], abs=1e-3)


def test_a_condition_that_collocation_would_lose_is_kept():
    """A jerk given at the end is neither a state nor a control: the plan is not refined."""
    made = changed(
        outputs=lambda s: {
            'x': Output((s.start, 0.0), (2.0, 0.0, 0.0, 0.0), free=4, derivatives=2),
            'y': Output((0.6, 0.0), (0.6, 0.0), free=4),
        }
    )
    plan = made().solve()
    assert plan.trajectory.interpolation == 'cubic'
    assert plan.trajectory.controls[-1, 0] == pytest.approx(0.0, abs=1e-6)


def test_start_conditions_and_a_free_start():
    """Leave a circle from wherever it is best, by `start_conditions`."""
    made = changed(
        outputs=lambda s: {
            'x': Output({1: 0.0}, (2.0, 0.0), free=5, scale=3.0),
            'y': Output({1: 0.0}, (0.0, 0.0), free=5, scale=1.0),
        },
        start_conditions=lambda s, t, x: ((x[0] + 2.0) ** 2 + x[1] ** 2 - 1.0,),
        margins=DirectProblem.margins,
        final_cost=lambda s, t, x: t,
    )
    plan = made().solve()
    x, y = plan.trajectory.states[0, :2]
    assert (x + 2.0) ** 2 + y**2 == pytest.approx(1.0, abs=1e-3)
    assert x == pytest.approx(-1.0, abs=0.02)


def test_a_control_that_jumps_with_a_force_is_not_overlooked_by_the_replay():
    case = {'force': 'wall', 'cost': 'nothing', 'mass': 0.1, 'largest': 7.4, 'speed': 1.65}
    case |= {'goal': 1.16, 'guess': 1.16, 'free': 3, 'solver.refine': False}
    outcome_of(case | {'mistake': 'none'})


def test_random_statements_are_planned_for_or_refused():
    random_statements(40)


def weights(self):
    return np.eye(3), np.eye(2)


def by_place(self, x):
    return [Disc((math.sin(x[0]), x[1]), 0.1)]


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'feedback_weights': weights}, r'gives Q of shape \(3, 3\), expected \(4, 4\)'),
        ({'drawing': by_place}, 'drawing of Changed raises TypeError'),
        ({'reserve': {'Pole': 0.1}}, "which is not a limit: there are 'pole', 'ax, lowest'"),
    ],
)
def test_a_check_refuses_what_only_a_tracker_or_a_picture_would_meet(change, words):
    with pytest.raises(InvalidProblem, match=words):
        check_problem(changed(**change)())


def test_a_start_inside_a_reserve_is_named_where_no_plan_is_found():
    stuck = changed(reserve={'pole': 0.5}, control_limits=lambda self: {'ax': (-1e-3, 1e-3)})
    words = "the start leaves 0.2 to the limit 'pole', less than its reserve 0.5"
    near = stuck(start=-math.sqrt(0.44), solver=SolverParameters(deadline=0.3))
    assert check_problem(near).reasons == [words]
    with pytest.raises(Infeasible, match=words):
        near.solve()


def test_the_rate_of_an_integrated_state_is_not_compared():
    class Rolling(Car):
        """Its way along y is integrated."""

        def outputs(self):
            return {'x': super().outputs()['x'], 'vy': Output((0.0,), (0.0,), free=4)}

        def integrated(self):
            return {'y': Integrated(0.1, 0.0)}

        def invert(self, y, z):
            (x, vx, ax), (vy, ay, _) = y['x'], y['vy']
            return (x, z['y'], vx, vy), (ax + self.drag * vx, ay + self.drag * vy)

    rows = check_problem(Rolling()).rates
    assert [row.state for row in rows if row.integrated] == ['y']


def test_the_end_that_is_missed_is_named_with_its_unit():
    class Far(Car):
        """Its way along y is integrated, and nothing is left to vary."""

        def duration(self):
            return Duration(1.0, fixed=True)

        def outputs(self):
            return {'x': super().outputs()['x'], 'vy': Output((0.0,), (1.0,))}

        def integrated(self):
            return {'y': Integrated(1.0, 40.0, scale=10.0)}

        def invert(self, y, z):
            (x, vx, ax), (vy, ay, _) = y['x'], y['vy']
            return (x, z['y'], vx, vy), (ax + self.drag * vx, ay + self.drag * vy)

    far = Far(limit=90.0, solver=DirectSolverParameters(deadline=3.0, refine=False))
    with pytest.raises(Infeasible, match=r'the condition at the end on y by 3\d m'):
        far.solve()

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Traces serve all problems of a kind: a plan does not depend on what was solved before."""

from dataclasses import dataclass, field, replace
import math
from threading import Thread
from typing import Any, ClassVar

import numpy as np
import pytest
from stated import Car, Cart, changed, refused
from tdm_planner.direct_method import Duration
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.tracing import _kind, numbers, Trace
from tdm_planner.parameters import group, parameter, positive, Validated


@dataclass(frozen=True)
class Rocks(Car):
    """A car among rocks that a parameter takes away."""

    rocks: float = parameter(1.0, '1: they are there, 0: they are not')

    def margins(self, t, x, u):
        places = (-0.8, 0.3, 0.5), (0.4, -0.4, 0.45), (1.1, 0.4, 0.4)
        away = [((x[0] - a) ** 2 + (x[1] - b) ** 2) / r**2 - 1.0 for a, b, r in places]
        return {f'rock{k}': 1.0 + self.rocks * (left - 1.0) for k, left in enumerate(away)}


def test_obstacles_are_those_of_the_problem_that_is_solved():
    found = []
    for before in (1.0, 0.0):
        Trace._made.clear()
        Rocks(rocks=before).solve(counted=True)
        found.append(Rocks(start=-1.9).solve(counted=True))
    assert found[0].cost == found[1].cost
    assert found[0].evaluations == found[1].evaluations


@dataclass(frozen=True)
class Body(Validated):
    mass: float = positive(1.0, 'mass', 'kg')

    @property
    def inertia(self):
        return self.mass


@dataclass(frozen=True)
class Heavy(Body):
    """Of four times the inertia."""

    @property
    def inertia(self):
        return 4.0 * self.mass


@dataclass(frozen=True)
class Weighed(Cart):
    """With a table, a group whose class may be another, and constants of the class."""

    SHARE: ClassVar[float] = 1.0
    body: Body = group(Body)
    table: Any = field(default_factory=lambda: np.ones(2000))

    def running_cost(self, t, x, u):
        return self.SHARE * self.table[1000] * (self.body.inertia * u[0]) ** 2


def test_constants_of_classes_groups_and_tables_are_a_part_of_the_kind(monkeypatch):
    table = np.ones(2000)
    table[1000] = 2.0
    assert Weighed().solve(counted=True).cost == pytest.approx(1.5, rel=1e-3)
    assert Weighed(body=Heavy()).solve(counted=True).cost == pytest.approx(24.0, rel=1e-3)
    assert Weighed(table=table).solve(counted=True).cost == pytest.approx(3.0, rel=1e-3)
    monkeypatch.setattr(Weighed, 'SHARE', 3.0)
    assert Weighed().solve(counted=True).cost == pytest.approx(4.5, rel=1e-3)


PRICE = 1.0
Priced = changed(Cart, running_cost=lambda s, t, x, u: PRICE * u[0] ** 2)  # no parameter


def test_what_functions_read_beside_parameters_counts_as_it_is_when_a_plan_is_made(monkeypatch):
    costs = []
    for price in (1.0, 3.0, 1.0):
        monkeypatch.setitem(globals(), 'PRICE', price)
        costs.append(Priced().solve(counted=True).cost)
    assert costs == pytest.approx([1.5, 4.5, 1.5], rel=1e-3)
    monkeypatch.setattr(Priced, 'running_cost', lambda self, t, x, u: 7.0 * u[0] ** 2)
    assert Priced().solve(counted=True).cost == pytest.approx(10.5, rel=1e-3)


def test_a_statement_may_solve_another_problem():
    """It hung: what traces one problem waited for itself to trace the other."""

    def duration(self):
        return Duration(2.0 * Cart(start=self.start).solve(counted=True).duration, fixed=True)

    slower = changed(Cart, duration=duration)()
    Trace._made.clear()
    found = []
    thread = Thread(target=lambda: found.append(slower.solve(counted=True)), daemon=True)
    thread.start()
    thread.join(60.0)
    assert found[0].cost == pytest.approx(12.0 / 4.0**3, rel=1e-3)


def test_a_large_table_costs_a_request_next_to_nothing():
    # As text it took seconds; a time is not asserted, but what is compared.
    table = np.random.default_rng(0).normal(size=100_000)
    stated = CheckedFormulation(Weighed(table=table))
    key = _kind(stated, numbers(stated.formulation))
    assert len(key[-1]) < 20_000
    table[70_000] += 1e-12
    assert _kind(stated, numbers(stated.formulation)) != key


def test_a_group_may_have_slots():
    @dataclass(frozen=True, slots=True)
    class Place:
        x: float = parameter(1.0, 'place')

    @dataclass(frozen=True)
    class Placed(Cart):
        place: Place = group(Place)

        def running_cost(self, t, x, u):
            return self.place.x * u[0] ** 2

    assert Placed().solve(counted=True).cost == pytest.approx(1.5, rel=1e-3)


def test_few_traces_are_kept_of_a_kind_whose_numbers_cannot_be_symbols():
    root = {'margins': lambda s, t, x, u: {'wall': math.sqrt(4.0 + s.start**2) - x[0]}}
    walled = changed(Cart, **root)
    Trace._made.clear()
    for start in np.linspace(0.5, 1.0, 10):
        walled(start=float(start)).prepare()
    (made,) = Trace._made.values()
    assert len(made) == 4


def test_a_statement_without_units_is_refused_when_it_is_prepared():
    bare = changed(Cart, state_units=None)()
    for make in (bare.prepare, bare.solve):
        assert refused(make).startswith('state_units = None must be a tuple of units')


def test_an_attribute_computed_beside_the_parameters_is_to_be_a_property():
    @dataclass(frozen=True)
    class Derived(Cart):
        """An attribute that follows from a parameter."""

        def __post_init__(self):
            object.__setattr__(self, 'square', self.limit**2)

        def margins(self, t, x, u):
            return {'force': 1.0 - u[0] ** 2 / self.square}

    told = refused(replace(Derived(), limit=5.0).solve)
    assert told.endswith("'square' follows from parameters: state it as a property")

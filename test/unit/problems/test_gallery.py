# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The gallery of docs/plants: statements that agree with themselves, planned at the optimum."""

import importlib
import inspect

import pytest
import table
from tdm_planner.problem_check import check_problem

PAGES = pytest.mark.parametrize(('module', 'name'), table.GALLERY.items())


@PAGES
def test_a_statement_is_short_and_its_best_known_optima_are_the_published_ones(module, name):
    page, known = importlib.import_module(module), table.best_known()[name]
    cls = getattr(page, name)
    parts = cls, type(cls().start)
    lines = [line for part in parts for line in inspect.getsource(part).splitlines()]
    assert sum(bool(line.strip()) for line in lines) < 60
    assert len(page.VARIATIONS) == 5
    assert set(known) == set(table.cases(page.VARIATIONS))
    for case, (value, _) in page.PUBLISHED.items():
        # the vehicle's inertia costs what the literature leaves out
        allowed = 2e-2 if name == 'Auv' else 1e-3
        assert -1e-3 * abs(value) <= known[case]['cost'] - value <= allowed * abs(value)


@PAGES
def test_the_default_is_sound_and_planned_near_the_best_known_optimum(module, name):
    problem = getattr(importlib.import_module(module), name)()
    assert check_problem(problem).reasons == []
    solution = problem.solve()
    best = table.best_known()[name]['default']['cost']
    assert solution.verification.ok
    assert solution.cost - best < 0.03 * abs(best)

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

import pytest
import table
from tdm_planner.problem_check import check_problem


@pytest.mark.parametrize(('module', 'name'), table.GALLERY.items())
def test_the_default_is_sound_and_planned_near_the_best_known_optimum(module, name):
    problem = getattr(importlib.import_module(module), name)()
    assert check_problem(problem).reasons == []
    solution = problem.solve()
    best = table.best_known()[name]['default']['cost']
    assert solution.verification.ok
    assert solution.cost - best < 0.03 * abs(best)

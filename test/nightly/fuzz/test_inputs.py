# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Thousands of new cases of bad input, a thousand plans of sabotaged solvers."""

from fuzzing import PROPERTIES, tried, try_out
from node_fuzzing import SixNodes
import pytest
from random_statements import outcome_of, STATEMENTS
from saboteurs import replayed_faults

FACTOR = 35  # above 10,000 cases


@pytest.mark.parametrize('name', PROPERTIES)
def test_bad_input_is_met_with_a_result_or_a_reason(name):
    try_out(name, FACTOR)


def test_a_thousand_random_statements_are_planned_for_or_refused():
    assert any(tried(STATEMENTS, outcome_of, 1000, new=True))


def test_nodes_survive_whatever_comes_and_serve_as_before(stepped):
    nodes = SixNodes(stepped)
    for _ in range(5):
        nodes.endure(400, new=True)


@pytest.mark.parametrize(('kind', 'wanted'), [('pendulum', 600), ('robots', 400)])
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind, wanted):
    bad = replayed_faults(kind, 2006, wanted)
    assert not bad, f'{len(bad)} of {wanted} plans: {bad[:3]}'

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Thousands of new cases of bad input, a thousand plans of sabotaged solvers."""

from fuzz_inputs import SPECIFICATIONS
from fuzzing import planned, PROPERTIES, tried, try_out
from hypothesis import strategies as st
from node_fuzzing import SixNodes
import numpy as np
import pytest
from random_statements import outcome_of, STATEMENTS
from saboteurs import blind_verification, PROBLEMS, replayed_faults
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems.solution import Solution

PENDULUM = SPECIFICATIONS['pendulum_swing_up']
FACTOR, UNCHECKED = 35, 300  # above 10,000 cases; plans
PATIENCE = 1.0  # s for problems that can be solved
BITES = 0.05  # least share that violates, unchecked: 43 of 150 pendulums did, 31 of 96 robots


@pytest.mark.parametrize('name', PROPERTIES)
def test_bad_input_is_met_with_a_result_or_a_reason(name):
    try_out(name, FACTOR)


def test_a_thousand_random_statements_are_planned_for_or_refused():
    assert any(tried(STATEMENTS, outcome_of, 1000, new=True))


@st.composite
def moderate_pendulums(draw) -> dict:
    """Nothing that anybody could object to: a rig like the real one, at a speed it can have."""
    parts = ('mass', 'com_distance', 'arm_length', 'inertia.disk')
    ends = {'limits.torque': (0.03, 0.2), 'limits.disk_angle': (0.8, 3.0),
            'torque_reserve': (0.0, 0.3), 'start.theta': (-4.0, 4.0), 'start.psi': (-0.5, 0.5),
            'start.theta_dot': (-2.0, 2.0), 'start.psi_dot': (-1.0, 1.0)}  # fmt: skip
    found = {name: draw(st.floats(*both)) for name, both in ends.items()}
    found['start.psi'] *= found['limits.disk_angle']
    sizes = {f'plant.{name}': draw(st.floats(0.8, 1.25)) for name in parts}
    return found | {name: size * PENDULUM[name].default for name, size in sizes.items()}


def test_what_is_valid_is_never_refused_and_often_planned_for():
    """Whoever refuses everything would pass all other tests here."""

    def solved(parameters: dict) -> bool:
        found = planned('pendulum_swing_up', parameters, PATIENCE)
        assert not isinstance(found, InvalidProblem), (str(found), parameters)
        return isinstance(found, Solution)

    assert np.mean(tried(moderate_pendulums(), solved, 250, new=True)) >= 1 / 4


def test_nodes_survive_whatever_comes_and_serve_as_before(stepped):
    nodes = SixNodes(stepped)
    for _ in range(5):
        nodes.endure(400, new=True)


@pytest.mark.parametrize(('kind', 'wanted'), [('pendulum', 600), ('robots', 400)])
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind, wanted):
    bad = replayed_faults(kind, 2006, wanted)
    assert not bad, f'{len(bad)} of {wanted} plans: {bad[:3]}'


@pytest.mark.parametrize('kind', PROBLEMS)
def test_without_the_check_many_would_and_the_check_sees_every_one(kind, monkeypatch):
    """The same sabotage of a solver whose check lets everything pass: the suite bites."""
    blind_verification(monkeypatch)
    bad = replayed_faults(kind, 3, UNCHECKED)
    unseen = [case for case in bad if not case[2]['verification']['reasons']]
    assert not unseen, f'{len(unseen)} of {len(bad)} are not seen: {unseen[:3]}'
    assert len(bad) >= BITES * UNCHECKED

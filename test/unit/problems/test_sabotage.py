# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans that leave sabotaged solvers violate no limit: a few here, a thousand by night."""

from __future__ import annotations

import pytest
from replays import faults
import saboteurs
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import PendulumSwingUp


@pytest.mark.parametrize(('kind', 'wanted'), [('pendulum', 10), ('robots', 6)])
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind: str, wanted: int) -> None:
    bad, _ = saboteurs.replayed_faults(kind, 2006, wanted)
    assert not bad


def test_the_replay_sees_what_is_wrong() -> None:
    """A plan that is changed after its check is told from a right one."""
    problem = PendulumSwingUp()
    document = plan_document(problem, problem.solve())
    assert not faults(document)
    states, controls = document['states'], document['controls']
    factor = 1.0001 / 0.7
    more = {**document, 'controls': {'torque': [factor * x for x in controls['torque']]}}
    assert any('torque' in fault for fault in faults(more))
    late = {**document, 'times': [1.001 * t for t in document['times']]}
    assert any('from the goal' in fault for fault in faults(late))
    moved = {**document, 'states': {**states, 'psi': [x + 0.01 for x in states['psi']]}}
    assert any('begins' in fault for fault in faults(moved))

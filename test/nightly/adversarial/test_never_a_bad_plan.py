# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""No plan that violates a limit leaves a sabotaged solver: a thousand of them."""

from __future__ import annotations

import pytest
from saboteurs import blind_verification, PROBLEMS, replayed_faults

UNCHECKED = 300
BITES = 0.05  # least share that violates, unchecked: 43 of 150 pendulums did, 31 of 96 robots


@pytest.mark.parametrize(('kind', 'wanted'), [('pendulum', 600), ('robots', 400)])
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind: str, wanted: int) -> None:
    bad, _ = replayed_faults(kind, 2006, wanted)
    assert not bad, f'{len(bad)} of {wanted} plans: {bad[:3]}'


@pytest.mark.parametrize('kind', sorted(PROBLEMS))
def test_without_the_check_many_would_and_the_check_sees_every_one(kind: str) -> None:
    """The same sabotage of a solver whose check lets everything pass: the suite bites."""
    with pytest.MonkeyPatch.context() as patch:
        blind_verification(patch)
        bad, counts = replayed_faults(kind, 3, UNCHECKED)
    unseen = [case for case in bad if not case[2]['verification']['reasons']]
    assert not unseen, f'{len(unseen)} of {len(bad)} are not seen: {unseen[:3]}'
    assert len(bad) >= BITES * UNCHECKED, counts

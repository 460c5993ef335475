# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""When a new plan takes over."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from tdm_planner.problems.base import Solution
from tdm_planner.replanning.decision import decide, LEAST_LEFT, Outlook, worth_improving
from tdm_planner.verification import Verification

COSTS = st.floats(0.0, 100.0)
OUTLOOKS = st.builds(
    Outlook, cost=COSTS, trouble=st.sampled_from(['', 'it falls']), settled=st.booleans()
)


def solution(cost: float, ok: bool = True) -> Solution:
    check = Verification(ok=ok, terminal_error=np.zeros(4))
    return Solution('test', {}, cost, 0.0, np.zeros(1), 1, 0.0, check)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(OUTLOOKS, st.booleans(), COSTS, st.floats(0.0, 1.0))
def test_only_a_verified_plan_takes_over(
    outlook: Outlook, changed: bool, cost: float, improvement: float
) -> None:
    assert not decide(outlook, changed, None, improvement).take_over
    assert not decide(outlook, changed, solution(cost, ok=False), improvement).take_over


@settings(deadline=None, max_examples=60, derandomize=True)
@given(OUTLOOKS, st.booleans(), COSTS, st.floats(0.0, 1.0))
def test_a_necessary_plan_takes_over_whatever_it_costs(
    outlook: Outlook, changed: bool, cost: float, improvement: float
) -> None:
    decision = decide(outlook, changed, solution(cost), improvement)
    if changed or outlook.trouble:
        assert decision.take_over
    assert decision.reason


@settings(deadline=None, max_examples=60, derandomize=True)
@given(st.floats(0.1, 100.0), st.floats(0.0, 2.0), st.floats(0.01, 1.0))
def test_where_the_old_plan_does_a_better_one_must_save_its_share(
    left: float, ratio: float, improvement: float
) -> None:
    decision = decide(Outlook(left), False, solution(ratio * left), improvement)
    if ratio >= 1.0 - improvement + 1e-9:
        assert not decision.take_over
    if ratio <= 1.0 - improvement - 1e-9:
        assert decision.take_over


@settings(deadline=None, max_examples=60, derandomize=True)
@given(OUTLOOKS, st.floats(0.1, 100.0))
def test_near_the_goal_nothing_better_is_looked_for(outlook: Outlook, whole: float) -> None:
    near = replace(outlook, cost=0.99 * LEAST_LEFT * whole)
    assert not worth_improving(near, whole, 0.1)
    assert not worth_improving(replace(outlook, settled=True), whole, 0.1)
    assert not worth_improving(outlook, whole, 1.0)

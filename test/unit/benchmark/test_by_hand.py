# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The hand-written search that overhead is measured against does what the library does."""

from pathlib import Path
import sys

import pytest


@pytest.fixture(autouse=True)
def _root(monkeypatch):
    monkeypatch.setattr(sys, 'path', [str(Path(__file__).parents[3]), *sys.path])


@pytest.mark.parametrize('regime', ['strong', 'weak'])
@pytest.mark.parametrize('seed', [0, 3])
def test_it_comes_by_the_same_plan(regime, seed):
    from benchmark import by_hand, overhead
    from benchmark.pendulum import problem, REGIMES, start_state

    made = problem(REGIMES[regime], start_state(seed))
    assert by_hand.solve(made) == pytest.approx(overhead.by_library(made).cost, rel=1e-6)


def test_the_minimisers_take_the_same_way():
    import math

    from benchmark import by_hand
    from benchmark.pendulum import problem, start_state
    import numpy as np
    from tdm_planner.direct_method import Budget
    from tdm_planner.problems.switching_search import Candidate, polish

    made = problem(0.09, start_state(1))
    durations, torques, turns = by_hand.arrivals(made, np.random.default_rng(0))[0]
    flat, _ = by_hand.polish(by_hand.numbers(made), durations, torques, turns, 12, math.inf)
    arcs = Candidate(durations, torques, turns)
    found, _ = polish(made.task, arcs, 12, 1e-8, Budget(60.0))
    np.testing.assert_allclose(found.durations, flat, rtol=1e-6, atol=1e-9)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Work that can wait gets a share of the time."""

from __future__ import annotations

from hypothesis import assume, given
from hypothesis import strategies as st
import pytest
from tdm_planner.nodes.ration import Ration


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_reserve_is_used_up_and_comes_back() -> None:
    clock = Clock()
    ration = Ration(0.01, 0.05, clock)
    ration.spent(0.04)
    assert ration.allows
    ration.spent(0.02)
    assert not ration.allows
    clock.now += 0.9  # 0.01 s are owed, 0.009 s have come
    assert not ration.allows
    clock.now += 0.2
    assert ration.allows


def test_what_is_overdrawn_is_told() -> None:
    clock = Clock()
    ration = Ration(0.01, 0.05, clock)
    assert ration.overdrawn == 0.0
    ration.spent(0.07)
    assert ration.overdrawn == pytest.approx(0.02)
    clock.now += 1.0
    assert ration.overdrawn == pytest.approx(0.01)


def test_no_more_than_the_reserve_is_saved() -> None:
    clock = Clock()
    ration = Ration(0.01, 0.05, clock)
    clock.now += 3600.0
    assert ration.allows
    ration.spent(0.0501)
    assert not ration.allows


@given(
    work=st.floats(1e-3, 0.1),
    share=st.floats(0.005, 0.5),
    reserve=st.floats(1e-3, 1.0),
)
def test_in_the_long_run_it_is_the_share(work: float, share: float, reserve: float) -> None:
    clock = Clock()
    ration = Ration(share, reserve, clock)
    done, span, step = 0.0, 60.0, 1e-2
    assume(min(work, reserve) >= share * step)  # there is more to do than the share allows
    for _ in range(round(span / step)):
        clock.now += step
        if ration.allows:
            ration.spent(work)
            done += work
    assert share * (span - 2 * step) <= done <= share * span + reserve + work

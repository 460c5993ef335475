# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math
import os

import pytest
from tools.memory import growth, MemoryRecord, resident


def test_the_slope_is_that_after_the_warm_up() -> None:
    times = [float(t) for t in range(0, 3600, 60)]
    sizes = [50.0 + t if t < 600 else 100.0 + 2.0 * t / 3600.0 for t in times]
    assert growth(times, sizes, 600.0) == pytest.approx(2.0)
    assert math.isnan(growth(times, sizes, 3500.0))


def test_a_process_that_has_ended_has_no_memory() -> None:
    assert resident(os.getpid()) > 10.0
    assert math.isnan(resident(2**22 + 1))


def test_a_record_keeps_every_process() -> None:
    record = MemoryRecord()
    for time in range(5):
        record.sample(float(time), {'this': os.getpid()})
    assert len(record.sizes['this']) == len(record.times) == 5
    assert math.isfinite(record.growth(0.0)['this'])

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
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

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Faults during a mission, in stepped time: some of data, all of which are tried by night."""

from data_faults import FAULTS, misled_rig, QUICK
from pendulum_rig import note
import pytest


@pytest.mark.parametrize('fault', QUICK)
def test_a_mission_under_a_fault_of_data(ros, fault):
    note(fault, **FAULTS[fault](misled_rig(ros, fault)))

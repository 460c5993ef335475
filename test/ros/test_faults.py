# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Faults during a mission, in stepped time: some of data, all of which are tried by night."""

from __future__ import annotations

from typing import Any

from data_faults import FAULTS, misled_rig, QUICK
from pendulum_rig import note
import pytest


@pytest.fixture(autouse=True)
def _ended() -> None:
    """Keep the nodes for the next fault."""


@pytest.mark.parametrize('fault', QUICK)
def test_a_mission_under_a_fault_of_data(ros: Any, fault: str) -> None:
    note(fault, **FAULTS[fault](misled_rig(ros, fault)))

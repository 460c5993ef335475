# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plant, tracker and planner are killed, one after the other, and come back."""

from __future__ import annotations

from killing import held_rig, SCENARIOS
from pendulum_rig import PendulumRig
import pytest
from ros_harness import Ros


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return held_rig(ros)


@pytest.mark.parametrize(
    'scenario', [name for name in SCENARIOS if name != 'plant killed in mid-swing']
)
def test_a_node_is_killed_and_the_pendulum_comes_back(rig: PendulumRig, scenario: str) -> None:
    rig.held_since(rig.now)
    SCENARIOS[scenario](rig)

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
from types import SimpleNamespace

import pytest
from tdm_sim.commands import MalformedCommand, read_joint


def message(name: list[str], effort: list[float]) -> SimpleNamespace:
    return SimpleNamespace(name=name, effort=effort, velocity=[])


def test_joints_are_found_by_name() -> None:
    command = message(['pendulum', 'disk'], [0.5, 0.01])
    assert read_joint(command, 'disk', 'effort') == 0.01
    assert read_joint(command, 'pendulum', 'effort') == 0.5


@pytest.mark.parametrize(
    ('command', 'words'),
    [
        (message([], []), "must name joint 'disk' once, but its names are: none"),
        (message(['arm'], [0.0]), "must name joint 'disk' once, but its names are: arm"),
        (message(['disk', 'disk'], [0.0, 1.0]), "must name joint 'disk' once"),
        (message(['disk'], []), "'effort' has 0 values for 1 named joint"),
        (message(['disk'], [0.0, 1.0]), "'effort' has 2 values for 1 named joint"),
        (message(['disk'], [math.nan]), "effort of joint 'disk' is nan"),
        (message(['disk'], [-math.inf]), "effort of joint 'disk' is -inf"),
    ],
)
def test_malformed_commands_say_why(command: SimpleNamespace, words: str) -> None:
    with pytest.raises(MalformedCommand, match=words):
        read_joint(command, 'disk', 'effort')

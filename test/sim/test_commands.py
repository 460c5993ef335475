# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
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

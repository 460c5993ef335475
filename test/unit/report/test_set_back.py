# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings with /clock: the stamps of their messages are not the recorder's time."""

from collections.abc import Sequence
import itertools
from pathlib import Path

import missions
from missions import after, Item, pendulum_recording, START, told, without
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.trajectory import SECOND
from tdm_sim.report.mission import Mission
from tdm_sim.report.reader import read_mission


def read(bag: Path, items: Sequence[Item]) -> Mission:
    return read_mission(missions.write(bag, items))


def ticks(begun: int, shift: int = 0) -> list[Item]:
    """Return simulated time that begins at `begun` [ns] 1.1 s before the motion, less a shift."""
    steps = np.arange(0, 6 * SECOND, SECOND // 10)
    stamps = [to_stamp(begun + int(step)) for step in steps]
    at = after(-1.1) - shift
    return [
        Item('/clock', at + int(k), Clock(clock=t)) for k, t in zip(steps, stamps, strict=True)
    ]


def test_of_a_simulation_that_began_anew_only_the_last_run_is_shown(tmp_path: Path) -> None:
    items, before = pendulum_recording(), pendulum_recording()
    for item in before:
        if item.topic.endswith('joint_states'):
            item.message.position = [1.0, 1.0]
    first = [item._replace(stamp=item.stamp - 10 * SECOND) for item in before]
    clock = ticks(after(-1.1)), ticks(after(-1.1), 10 * SECOND)
    mission = read(tmp_path / 'bag', [*first, *items, *itertools.chain(*clock)])
    missions.check_pendulum(mission)
    assert mission.vehicles[0].states.times.size == 500
    assert told(mission, 'Simulated time was set back')


@pytest.mark.parametrize('first', [0, SECOND])
@pytest.mark.parametrize(
    ('stray', 'stamp'), [('joint_command', 0), ('trajectory', 0), ('joint_states', START)]
)
def test_a_stamp_of_zero_or_another_clock_in_a_simulation(tmp_path, stray, stamp, first):
    """What came before it was not shown, the plan with it; of the plan, not for 50 years."""
    items = without(pendulum_recording(), '/plan_summary')
    begun = min(nanoseconds_of(item.message.header.stamp) for item in items)
    for item in items:
        instant = nanoseconds_of(item.message.header.stamp) - begun + first
        item.message.header.stamp = to_stamp(instant)
    chosen = [item for item in items if item.topic.endswith(stray)]
    chosen[len(chosen) // 2].message.header.stamp = to_stamp(stamp)
    mission = read(tmp_path / 'bag', [*items, *ticks(first)])
    assert not told(mission, 'set back')
    assert len(mission.vehicles[0].plans) == 1
    assert mission.vehicles[0].states.times.size >= 499
    assert -1.1 < mission.span[0] < mission.span[1] < 5.1

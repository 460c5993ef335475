# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Many clients at once; a minute of them, and twelve robots, with TDM_LOAD=nightly."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

NIGHTLY = os.environ.get('TDM_LOAD') == 'nightly'
GROWTH = 5.0  # MB, while the planner answers thousands of requests
AT_ONCE = 200.0  # ms, in which 99 % of those that are refused as BUSY are told so
PERIOD_ERROR = 8.0  # ms, of 99 % of the periods between commands under load


@pytest.fixture(autouse=True)
def domain(ros: object) -> None:
    """Run in the ROS domain of the test module."""


def test_every_call_of_many_clients_is_answered(tmp_path: Path) -> None:
    from tools.load import clients

    # Plant and tracker before others, as on a robot's computer, where that is allowed.
    real_time = 10 if NIGHTLY and os.geteuid() == 0 else 0
    found = clients(60.0 if NIGHTLY else 6.0, 20, tmp_path, real_time)
    assert found['unanswered'] == 0
    assert set(found['answers']) <= {'PLAN', 'BUSY', 'DEADLINE', 'NO_STATE', 'INFEASIBLE'}
    assert found['answers']['BUSY'] > 0
    memory = found['memory [MB]']
    assert memory['last'] - memory['half way'] < GROWTH
    if NIGHTLY:  # a machine of its own
        assert found['latency [ms]']['BUSY']['p99'] < AT_ONCE
        assert not real_time or found['period error under load [ms]']['p99'] <= PERIOD_ERROR


@pytest.mark.skipif(not NIGHTLY, reason='two minutes: TDM_LOAD=nightly')
def test_twelve_robots_hold_their_rates_or_say_that_they_do_not(tmp_path: Path) -> None:
    from tools.load import robots

    assert robots(20.0, 12, tmp_path)['of which silent about it'] == []


def test_only_a_warning_that_names_the_rate_counts_as_told() -> None:
    pytest.importorskip('rclpy')
    from tools.load import told_slow

    assert told_slow({'level': 1, 'message': 'idle; commands at 40 Hz instead of 200: busy'})
    assert not told_slow({'level': 0, 'message': 'idle; commands at 40 Hz instead of 200: busy'})
    assert not told_slow({'level': 1, 'message': 'idle'})

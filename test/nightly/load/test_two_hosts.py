# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pendulum with its planner and tracker on another host; needs root and iproute2."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tools.streams import compare
from tools.two_hosts import fly, LINKS
from tools.two_networks import why_not

ROOM = ('solver.deadline:=2.0', 'start.delay:=3.0')  # machines of CI are slow


@pytest.mark.skipif(os.environ.get('TDM_LOAD') != 'nightly', reason='real time: TDM_LOAD=nightly')
@pytest.mark.parametrize('link', ['clean', 'bad'])
def test_the_pendulum_is_swung_up_from_another_host(link: str, tmp_path: Path) -> None:
    pytest.importorskip('rclpy')
    reason = why_not()
    if reason:
        pytest.skip(reason)
    found = fly('pendulum', LINKS[link], tmp_path, ROOM)
    assert not found['unclean']
    age = found['streams']['/pendulum/joint_states']['age_p50']
    if link == 'clean':
        assert found['reached'], found['reasons']
    else:  # whether it is caught is a matter of chance: see test_late_link.py
        assert age > 15.0, 'the messages have not gone over the link'


def test_what_is_lost_late_or_overtaken_is_counted() -> None:
    stamps = np.arange(100) * 0.01
    sent = np.column_stack([stamps, stamps])
    arrived = np.column_stack([stamps, stamps + 0.02])
    arrived[[40, 41]] = arrived[[41, 40]]
    stream = compare(sent, np.delete(arrived, [10, 11, 12], axis=0), 0.01, (0.0, 1.0))
    assert (stream.sent, stream.lost, stream.overtaken) == (100, 3, 1)
    assert stream.age_p50 == pytest.approx(20.0)
    assert stream.gap_worst == pytest.approx(40.0)
    assert stream.period_error_worst == pytest.approx(0.0, abs=1e-6)

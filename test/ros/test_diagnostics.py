# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ros_harness import Ros
from tdm_planner.nodes.diagnostics import Diagnostics, Level, Report


def test_levels_are_numbered_as_in_the_message() -> None:
    for level in Level:
        assert bytes([level]) == getattr(DiagnosticStatus, level.name)


def test_published_every_second_and_on_change(ros: Ros) -> None:
    reports = [Report(Level.OK, 'fine', {'figure': 1 / 3, 'count': 2})]
    diagnostics = Diagnostics(ros.node, 'something', lambda: reports[-1])
    received = ros.subscribe('/diagnostics', DiagnosticArray)
    assert ros.spin_until(lambda: len(received) >= 1)
    (status,) = received[0].status
    assert (status.level, status.name, status.message) == (b'\x00', '/test: something', 'fine')
    assert {item.key: item.value for item in status.values} == {
        'figure': '0.333333',
        'count': '2',
    }
    assert received[0].header.stamp.sec > 0

    count = len(received)
    diagnostics.update()
    ros.spin_for(0.1)
    assert len(received) == count
    reports.append(Report(Level.ERROR, 'broken'))
    diagnostics.update()
    assert ros.spin_until(lambda: received[-1].status[0].message == 'broken', 0.5)
    count = len(received)
    assert ros.spin_until(lambda: len(received) >= count + 2)

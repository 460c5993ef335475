# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the diagnostics tell of who has found whom."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import pytest
from tdm_sim.connections import Connections

TRACKER, PLANT = '/pendulum/tracker', '/pendulum/pendulum_plant'


def told(name: str, **figures: str) -> DiagnosticArray:
    values = [KeyValue(key=key, value=value) for key, value in figures.items()]
    return DiagnosticArray(status=[DiagnosticStatus(name=f'{name}: something', values=values)])


@pytest.mark.parametrize(
    ('age', 'planners', 'connected'),
    [('0.004', '1', True), ('inf', '1', False), ('0.004', '0', False), ('?', '1', False)],
)
def test_a_tracker_needs_states_and_a_planner(age: str, planners: str, connected: bool) -> None:
    connections = Connections()
    assert not connections.tracker(TRACKER)
    connections.take(told(TRACKER, **{'state age [s]': age, 'planners': planners}))
    assert connections.tracker(TRACKER) == connected
    assert not connections.tracker('/other/tracker')


@pytest.mark.parametrize(('accepted', 'connected'), [('0', False), ('12', True)])
def test_a_plant_needs_commands(accepted: str, connected: bool) -> None:
    connections = Connections()
    connections.take(told(PLANT, **{'commands accepted': accepted}))
    assert connections.plant(PLANT) == connected


def test_the_newest_word_counts() -> None:
    connections = Connections()
    connections.take(told(PLANT, **{'commands accepted': '12'}))
    connections.take(told(PLANT, **{'commands accepted': '0'}))
    assert not connections.plant(PLANT)

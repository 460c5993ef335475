# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Streams of states that freeze, come late, lose, repeat or mix up messages: a mission over DDS.

What is promised is written in docs/reliability.md; what was measured is printed (pytest -rP).
"""

from __future__ import annotations

from pendulum_rig import COMMAND_TIMEOUT, note, PendulumRig, STATE_TIMEOUT
import pytest
from ros_harness import Ros

HARMLESS = [('delay', 0.05), ('delay', 0.07), ('drop', 0.05), ('drop', 0.5), ('duplicate', 0.03),
            ('reorder', 0.03), ('unstamped', 0.0)]  # fmt: skip
SILENT = [('freeze', 0.0), ('shift', 5.0), ('shift', -5.0), ('repeat', 0.0), ('shift', -2e9)]
SILENCE = 0.6  # s
SAFE = STATE_TIMEOUT + COMMAND_TIMEOUT  # s within which the torque is off, at the latest
STUCK_SAFE = 4 * STATE_TIMEOUT + COMMAND_TIMEOUT
JITTER = 0.05  # s between the plant's clock and a message on a busy machine
MOST_LEAN = 0.35  # rad from upright, shortly after the catch
HELD_LEAN = 0.15  # rad, while being held


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return PendulumRig(ros, 'rig', relayed=True, lockstep=True)


def moment(rig: PendulumRig, phase: str) -> float:
    """Begin a mission; return an instant [s] in mid-swing, or soon while the hold lasts."""
    return 0.5 * sum(rig.begin()) if phase == 'swing' else rig.swing_up() + 0.5


@pytest.mark.parametrize(('kind', 'amount'), HARMLESS)
def test_the_swing_up_and_the_hold_go_on(rig: PendulumRig, kind: str, amount: float) -> None:
    start, end = rig.begin()
    rig.fault(kind, amount, 0.5 * (start + end))
    rig.wait_until(end + 1.8)
    caught, held = rig.lean(end + 0.3, end + 0.8), rig.lean(end + 0.8)
    note(f'{kind} {amount:g}', caught=caught, held=held)
    assert rig.says('tracker', 'holding'), rig.story()
    assert caught < MOST_LEAN, rig.story()
    assert held < HELD_LEAN, rig.story()


@pytest.mark.parametrize(('kind', 'amount'), HARMLESS)
def test_the_hold_goes_on(rig: PendulumRig, kind: str, amount: float) -> None:
    at = moment(rig, 'hold')
    rig.fault(kind, amount, at)
    rig.wait_until(at + 3.0)
    note(f'{kind} {amount:g} while holding', held=rig.lean(at))
    assert rig.is_upright, rig.story()
    assert rig.lean(at) < HELD_LEAN, rig.story()


@pytest.mark.parametrize('phase', ['swing', 'hold'])
@pytest.mark.parametrize(('kind', 'amount'), SILENT)
def test_without_states_it_is_safe_and_swings_up_again(
    rig: PendulumRig, kind: str, amount: float, phase: str
) -> None:
    """The torque goes off in time, the mission is completed afterwards."""
    at = moment(rig, phase)
    rig.fault(kind, amount, at, SILENCE)
    end = at + SILENCE
    rig.wait_until(end)
    rig.mend()
    safe = rig.last_torque(at, end)
    assert rig.said('tracker', 'state_timeout'), rig.story()
    note(f'{kind} {amount:g} in {phase}', safe=safe, recovered=rig.held_since(end) - end)
    assert safe < SAFE + JITTER, rig.story()


@pytest.mark.parametrize('phase', ['swing', 'hold'])
def test_a_sensor_that_repeats_itself_is_noticed(rig: PendulumRig, phase: str) -> None:
    at = moment(rig, phase)
    rig.fault('stuck', at=at)
    rig.wait(lambda: rig.says('tracker', 'is a sensor stuck?'))
    rig.wait_until(at + 1.5)
    safe = rig.last_torque(at, at + 1.5)
    rig.mend()
    end = rig.now
    note(f'stuck in {phase}', safe=safe, recovered=rig.held_since(end) - end)
    assert safe < STUCK_SAFE + JITTER, rig.story()


def test_the_largest_delay(rig: PendulumRig) -> None:
    """What state_timeout leaves, and more where it is raised."""
    tracker = f'/{rig.namespace}/tracker'
    assert rig.ros.set_parameters(tracker, state_timeout=1.0) == ['']
    largest = 0.0
    try:
        for delay in (0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3):
            at = moment(rig, 'hold')
            rig.fault('delay', delay, at)
            rig.wait_until(at + 4.0)
            note(f'delay {delay} with state_timeout 1 s', held=rig.lean(at))
            if rig.lean(at) > 0.5:
                break
            largest = delay
    finally:
        rig.mend()
        assert rig.ros.set_parameters(tracker, state_timeout=STATE_TIMEOUT) == ['']
    assert largest >= 0.08

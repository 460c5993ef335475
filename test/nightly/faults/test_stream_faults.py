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

What is promised is written in docs/reliability.md. One runs always, all with TDM_FAULTS=all; they
print what was measured.
"""

from __future__ import annotations

import os

from faulty_relay import stamps
from pendulum_rig import COMMAND_TIMEOUT, PendulumRig, STATE_TIMEOUT
import pytest
from ros_harness import Ros

ALL = os.environ.get('TDM_FAULTS') == 'all'
by_night = pytest.mark.skipif(not ALL, reason='missions of minutes: set TDM_FAULTS=all')

HARMLESS = [('delay', 0.05), ('drop', 0.05), ('duplicate', 0.03), ('reorder', 0.03)]
MORE_HARMLESS = [('delay', 0.07), ('drop', 0.5), ('unstamped', 0.0)]
SILENT = [('freeze', 0.0), ('shift', 5.0), ('shift', -5.0)]
MORE_SILENT = [('repeat', 0.0), ('shift', -2e9)]
SILENCE = 0.6  # s
SAFE = STATE_TIMEOUT + COMMAND_TIMEOUT  # s within which the torque is off, at the latest
JITTER = 0.05  # s between the plant's clock and a message on a busy machine
MOST_LEAN = 0.35  # rad from upright, shortly after the catch
HELD_LEAN = 0.15  # rad, while being held


def told(*what: object) -> None:
    """Print what was measured, for the documentation; shown with pytest's -rP."""
    print('measured:', *what)


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return PendulumRig(ros)


def ids(cases: list[tuple[str, float]]) -> list[str]:
    return [f'{kind} {amount:g}' for kind, amount in cases]


@by_night
@pytest.mark.parametrize(('kind', 'amount'), HARMLESS, ids=ids(HARMLESS))
def test_the_swing_up_and_the_hold_go_on(rig: PendulumRig, kind: str, amount: float) -> None:
    check_whole_mission(rig, kind, amount)


@by_night
@pytest.mark.parametrize(('kind', 'amount'), MORE_HARMLESS, ids=ids(MORE_HARMLESS))
def test_so_they_do_where_it_is_worse(rig: PendulumRig, kind: str, amount: float) -> None:
    check_whole_mission(rig, kind, amount)


def check_whole_mission(rig: PendulumRig, kind: str, amount: float) -> None:
    """Let it go on from mid-swing until held for a second and a half."""
    start, end = rig.begin()
    rig.fault(kind, amount, **stamps(0.5 * (start + end)))
    assert rig.wait_until(end + 1.8), rig.story()
    caught, held = rig.lean(end + 0.3, end + 0.8), rig.lean(end + 0.8)
    told(kind, amount, f'largest lean {caught:.3f} rad after the catch, {held:.3f} rad held')
    assert rig.says('holding'), rig.story()
    assert caught < MOST_LEAN, rig.story()
    assert held < HELD_LEAN, rig.story()


@by_night
@pytest.mark.parametrize(('kind', 'amount'), HARMLESS + MORE_HARMLESS)
def test_the_hold_goes_on(rig: PendulumRig, kind: str, amount: float) -> None:
    at = rig.swing_up() + 0.5
    rig.fault(kind, amount, **stamps(at))
    assert rig.wait_until(at + 3.0), rig.story()
    lean = rig.lean(at)
    told(kind, amount, f'while holding: largest lean {lean:.3f} rad')
    assert rig.is_upright, rig.story()
    assert lean < HELD_LEAN, rig.story()


def check_safe(rig: PendulumRig, kind: str, amount: float, at: float, silence: float) -> None:
    """Check that the torque goes off in time, and that the mission is completed afterwards."""
    assert rig.wait_until(at + silence), rig.story()
    rig.mend()
    safe = rig.last_torque(at, at + silence)
    assert any('state_timeout' in s.message for s in rig.statuses()), rig.story()
    recovered = rig.recovered_after(at + silence)
    told(kind, amount, f'torque off after {safe:.3f} s, held {recovered:.2f} s after the end')
    assert safe < SAFE + JITTER, rig.story()


@pytest.mark.parametrize(
    ('kind', 'amount'), SILENT if ALL else SILENT[:1], ids=ids(SILENT if ALL else SILENT[:1])
)
def test_without_states_while_holding_it_is_safe_and_swings_up_again(
    rig: PendulumRig, kind: str, amount: float
) -> None:
    at = rig.swing_up() + 0.5
    rig.fault(kind, amount, **stamps(at, SILENCE))
    check_safe(rig, kind, amount, at, SILENCE)


@by_night
@pytest.mark.parametrize(('kind', 'amount'), MORE_SILENT)
def test_so_it_does_with_stamps_that_make_no_sense(
    rig: PendulumRig, kind: str, amount: float
) -> None:
    at = rig.swing_up() + 0.5
    rig.fault(kind, amount, **stamps(at, SILENCE))
    check_safe(rig, kind, amount, at, SILENCE)


@by_night
@pytest.mark.parametrize(('kind', 'amount'), SILENT, ids=ids(SILENT))
def test_without_states_in_mid_swing_it_is_safe_and_swings_up_again(
    rig: PendulumRig, kind: str, amount: float
) -> None:
    start, end = rig.begin()
    at = 0.5 * (start + end)
    rig.fault(kind, amount, **stamps(at, SILENCE))
    check_safe(rig, kind, amount, at, SILENCE)


STUCK_SAFE = 4 * STATE_TIMEOUT + COMMAND_TIMEOUT


@by_night
@pytest.mark.parametrize('phase', ['swing', 'hold'])
def test_a_sensor_that_repeats_itself_is_noticed(rig: PendulumRig, phase: str) -> None:
    if phase == 'swing':
        start, end = rig.begin()
        at = 0.5 * (start + end)
    else:
        at = rig.swing_up() + 0.5
    rig.fault('stuck', **stamps(at))
    assert rig.wait(lambda: rig.says('is a sensor stuck?')), rig.story()
    assert rig.wait_until(at + 1.5)
    safe = rig.last_torque(at, at + 1.5)
    rig.mend()
    end = rig.newest[0]
    recovered = rig.recovered_after(end)
    told(
        'stuck',
        phase,
        f'torque off after {safe:.3f} s, held {recovered:.2f} s after the end',
    )
    assert safe < STUCK_SAFE + JITTER, rig.story()


@by_night
def test_the_largest_delay(rig: PendulumRig) -> None:
    """What state_timeout leaves, and more where it is raised."""
    assert rig.ros.set_parameters(f'/{rig.namespace}/tracker', state_timeout=1.0) == ['']
    largest = 0.0
    try:
        for delay in (0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3):
            at = rig.swing_up() + 0.5
            rig.fault('delay', delay, **stamps(at))
            rig.wait_until(at + 4.0)
            lean = rig.lean(at)
            told('delay', delay, f'with state_timeout 1 s: lean {lean:.3f} rad')
            if lean > 0.5:
                break
            largest = delay
    finally:
        rig.mend()
        assert rig.ros.set_parameters(f'/{rig.namespace}/tracker', state_timeout=0.1) == ['']
    assert largest >= 0.08

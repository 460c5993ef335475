# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Clocks that are set while a plant moves: the computer's time of day, and a simulator's."""

from __future__ import annotations

import math
import os
from pathlib import Path
import shutil
import struct
import subprocess
import time

from builtin_interfaces.msg import Time
from faulty_relay import SECOND
from pendulum_rig import PATIENCE, PendulumRig
import pytest
from ros_harness import Ros
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import nanoseconds_of

STEPS = [5.0, -5.0]
ALL = os.environ.get('TDM_FAULTS') == 'all'
pytestmark = pytest.mark.skipif(not ALL, reason='missions of minutes: set TDM_FAULTS=all')


def told(*what: object) -> None:
    """Print what was measured, for the documentation; shown with pytest's -rP."""
    print('measured:', *what)


class TimeOfDay:
    """The time of day of processes started with `environment`, which can be set."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / 'offset'
        self._file.write_bytes(struct.pack('q', 0))
        library = folder / 'settable_clock.so'
        source = Path(__file__).with_name('settable_clock.c')
        compiler = shutil.which('cc') or shutil.which('gcc')
        if compiler is None:
            pytest.skip('a C compiler is needed to give processes a clock that can be set')
        subprocess.run(
            [compiler, '-O2', '-shared', '-fPIC', '-o', str(library), str(source), '-ldl'],
            check=True,
        )
        self.environment = {'LD_PRELOAD': str(library), 'TIME_OF_DAY_OFFSET': str(self._file)}

    def put_off(self, seconds: float) -> None:
        """Set it to what it really is and so much more."""
        with self._file.open('r+b') as file:
            file.write(struct.pack('q', round(seconds * SECOND)))


@pytest.fixture
def time_of_day(tmp_path: Path) -> TimeOfDay:
    return TimeOfDay(tmp_path)


@pytest.mark.parametrize('step', STEPS)
def test_the_time_of_day_is_set_and_nothing_stops(
    ros: Ros, time_of_day: TimeOfDay, step: float
) -> None:
    """Timers fire, states are fresh; without mending, all would stand still for five seconds."""
    space = 'forth' if step > 0 else 'back'
    plant = ros.start(
        'tdm_sim.pendulum_plant', namespace=space, environment=time_of_day.environment
    )
    tracker = ros.start(
        'tdm_planner.nodes.tracker', namespace=space, environment=time_of_day.environment
    )
    states = ros.subscribe(f'/{space}/joint_states', JointState, 100)
    commands = ros.subscribe(f'/{space}/joint_command', JointState, 100)
    assert ros.spin_until(lambda: len(states) > 50 and len(commands) > 50, PATIENCE)
    time_of_day.put_off(step)
    counts = len(states), len(commands)
    began = time.monotonic()
    assert ros.spin_until(
        lambda: len(states) > counts[0] + 100 and len(commands) > counts[1] + 100, PATIENCE
    )
    took = time.monotonic() - began
    told('time of day set by', step, f's: 100 states and commands more in {took:.2f} s')
    leap = nanoseconds_of(states[-1].header.stamp) - nanoseconds_of(states[0].header.stamp)
    assert leap * step > 0
    assert ros.spin_until(lambda: 'the clock was set by' in tracker.output, PATIENCE)
    assert 'the process was stalled' not in plant.output
    for process in (tracker, plant):
        process.end_cleanly()


@pytest.mark.parametrize('phase', ['swing', 'hold'])
@pytest.mark.parametrize('step', STEPS)
def test_the_time_of_day_is_set_and_the_mission_goes_on(
    ros: Ros, time_of_day: TimeOfDay, step: float, phase: str
) -> None:
    namespace = f'{"forth" if step > 0 else "back"}_{phase}'
    rig = PendulumRig(ros, namespace, lockstep=False, environment=time_of_day.environment)
    if phase == 'hold':
        rig.swing_up()
    else:
        start, end = rig.begin()
        assert rig.wait_until(0.5 * (start + end))
    time_of_day.put_off(step)
    known = len(rig.states)
    assert rig.wait(lambda: len(rig.states) > known + 400)
    first = known + 100
    del rig.states[:first]
    lean = rig.lean(-math.inf)
    told('time of day set by', step, phase, f'lean {lean:.3f} rad')
    assert rig.says('holding'), rig.story()
    assert lean < 0.3, rig.story()
    for process in (rig.plant, rig.relay, rig.tracker, rig.planner):
        process.end_cleanly()


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return PendulumRig(ros, 'simulated')


def test_a_simulated_clock_that_leaps_ahead_stops_no_hold(rig: PendulumRig) -> None:
    rig.swing_up()
    rig.clock(leap=5.0)
    at = rig.newest[0]
    assert rig.wait_until(at + 1.0)
    told('simulated clock +5 s', f'lean {rig.lean(at):.3f} rad')
    assert rig.is_upright, rig.story()
    assert rig.lean(at) < 0.2, rig.story()


def test_a_simulated_clock_set_back_is_safe_and_it_swings_up_again(rig: PendulumRig) -> None:
    rig.swing_up()
    known = len(rig.states)
    rig.clock(leap=-5.0)
    assert rig.wait(lambda: 'the clock was set back' in rig.tracker.output), rig.story()
    del rig.states[:known]
    at = rig.newest[0]
    assert rig.wait_until(at + 0.5)
    torques = rig.measured(at + 0.2)[:, 3]
    told('simulated clock -5 s: torque', abs(torques).max(), 'N m')
    assert not torques.any(), rig.story()
    rig.swing_up()


def test_negative_simulated_times_are_left_out(rig: PendulumRig) -> None:
    rig.swing_up()
    rig.clock(odd=(-5.0, -(2.0**31)))
    at = rig.newest[0]
    assert rig.wait_until(at + 1.0), rig.story()
    assert rig.wait(lambda: 'must not be negative' in rig.tracker.output), rig.story()
    rig.clock()
    assert rig.is_upright, rig.story()
    assert all(p.running for p in (rig.plant, rig.tracker, rig.planner, rig.relay))


@pytest.mark.parametrize('instants', [(0.0,), (-1.0, 0.0, 3.0), (2147483647.0, 1.0, 5.0)])
def test_nodes_live_through_any_simulated_time(ros: Ros, instants: tuple[float, ...]) -> None:
    space = f'odd{len(instants)}_{abs(int(instants[0]))}'
    ticks = 0
    nodes = [
        ros.start(
            module,
            {'use_sim_time': True},
            namespace=space,
            arguments=['-r', f'/clock:=/{space}/clock'],
        )
        for module in ('tdm_sim.pendulum_plant', 'tdm_planner.nodes.tracker')
    ]
    publisher = ros.node.create_publisher(Clock, f'/{space}/clock', 10)
    commands = ros.subscribe(f'/{space}/joint_command', JointState, 100)

    def ticked() -> bool:
        nonlocal ticks
        ticks += 1
        for base in instants:
            moment = Time(sec=int(base), nanosec=ticks * 5_000_000 % SECOND)
            publisher.publish(Clock(clock=moment))
        return ticks > 100 and bool(commands)

    assert ros.spin_until(ticked, PATIENCE), nodes[1].output
    ros.node.destroy_publisher(publisher)
    assert all(abs(c.effort[0]) == 0.0 for c in commands)
    for node in nodes:
        node.end_cleanly()

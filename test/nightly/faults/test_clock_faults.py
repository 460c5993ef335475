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

from contextlib import closing
import math
from pathlib import Path
import shutil
import struct
import subprocess

from builtin_interfaces.msg import Time
from pendulum_rig import note, PATIENCE, PendulumRig, SECOND
import pytest
from ros_harness import Ros
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

by_steps = pytest.mark.parametrize('step', [5.0, -5.0])


class TimeOfDay:
    """The time of day of processes started with `environment`, which can be set."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / 'offset'
        self.put_off(0.0)
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
        self._file.touch()
        with self._file.open('r+b') as file:
            file.write(struct.pack('q', round(seconds * SECOND)))


@by_steps
@pytest.mark.parametrize('phase', ['swing', 'hold'])
def test_the_time_of_day_is_set_and_the_mission_goes_on(
    ros: Ros, tmp_path: Path, step: float, phase: str
) -> None:
    """Timers fire, states are fresh; without mending, all would stand still for five seconds."""
    time_of_day = TimeOfDay(tmp_path)
    namespace = f'{"forth" if step > 0 else "back"}_{phase}'
    environment = time_of_day.environment
    with closing(PendulumRig(ros, namespace, relayed=True, environment=environment)) as rig:
        if phase == 'hold':
            rig.swing_up()
        else:
            start, end = rig.begin()
            rig.wait_until(0.5 * (start + end))
        time_of_day.put_off(step)
        before, known, commanded = rig.now, len(rig.states), len(rig.commands)
        rig.wait(lambda: len(rig.states) > known + 400 and len(rig.commands) > commanded + 100)
        assert (rig.now - before) * step > 0
        del rig.states[: known + 100]
        lean = rig.lean(-math.inf)
        note(f'time of day set by {step} s in {phase}', lean=lean)
        assert rig.says('tracker', 'holding'), rig.story()
        assert lean < 0.3, rig.story()
        rig.wait(lambda: 'the clock was set by' in rig.processes['tracker'].output)
        assert 'the process was stalled' not in rig.processes['plant'].output
        for process in rig.processes.values():
            process.end_cleanly()


@pytest.fixture(scope='module')
def rig(ros: Ros) -> PendulumRig:
    return PendulumRig(ros, 'simulated', relayed=True, lockstep=True)


def test_a_simulated_clock_that_leaps_ahead_stops_no_hold(rig: PendulumRig) -> None:
    rig.swing_up()
    rig.clock(leap=5.0)
    at = rig.now
    rig.wait_until(at + 1.0)
    note('simulated clock +5 s', lean=rig.lean(at))
    assert rig.is_upright, rig.story()
    assert rig.lean(at) < 0.2, rig.story()


def test_a_simulated_clock_set_back_is_safe_and_it_swings_up_again(rig: PendulumRig) -> None:
    rig.swing_up()
    known = len(rig.states)
    rig.clock(leap=-5.0)
    rig.wait(lambda: 'the clock was set back' in rig.processes['tracker'].output)
    del rig.states[:known]
    at = rig.now
    rig.wait_until(at + 0.5)
    torques = rig.measured(at + 0.2)[:, 3]
    assert not torques.any(), rig.story()
    rig.swing_up()


def test_negative_simulated_times_are_left_out(rig: PendulumRig) -> None:
    rig.swing_up()
    rig.clock(odd=(-5.0, -(2.0**31)))
    rig.wait_until(rig.now + 1.0)
    rig.wait(lambda: 'must not be negative' in rig.processes['tracker'].output)
    rig.clock()
    assert rig.is_upright, rig.story()
    assert all(process.running for process in rig.processes.values())


@pytest.mark.parametrize('instants', [(0.0,), (-1.0, 0.0, 3.0), (2147483647.0, 1.0, 5.0)])
def test_nodes_live_through_any_simulated_time(ros: Ros, instants: tuple[float, ...]) -> None:
    space = f'odd{len(instants)}_{abs(int(instants[0]))}'
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
    ticks = 0

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

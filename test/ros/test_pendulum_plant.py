# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node as a process over DDS; what all plant nodes have in common is tested here."""

from __future__ import annotations

import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

MODULE = 'tdm_sim.pendulum_plant'
# Long enough that the machine may be busy, and that a command acts until the test looks.
PATIENT = {'command_timeout': 30.0}


class Rig:
    """A pendulum in a namespace of its own, and everything it publishes."""

    def __init__(self, ros: Ros, name: str, parameters: dict[str, Any]) -> None:
        self.ros = ros
        self.node = f'/{name}/pendulum_plant'
        self.states = ros.subscribe(f'/{name}/joint_states', JointState, 1000)
        self.diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 100)
        self.process: NodeProcess = ros.start(MODULE, parameters, namespace=name)
        assert ros.spin_until(lambda: bool(self.states), 20.0), self.process.output
        self.commands = ros.publisher(f'/{name}/joint_command', JointState)
        self.name = name
        assert ros.commands_act(
            lambda torque: self.command(['disk'], [torque]), lambda: self.states[-1].effort[1]
        ), self.process.output
        del self.states[:-1]

    def command(self, names: list[str], effort: list[float]) -> None:
        self.commands.publish(JointState(name=names, effort=effort))

    def until(self, condition: Any) -> bool:
        """Wait for a state that fulfils `condition`, from now on."""
        self.states.clear()
        return self.ros.spin_until(lambda: any(condition(s) for s in self.states))

    def status(self, condition: Any) -> bool:
        """Wait for a diagnostic status of this node that fulfils `condition`, from now on."""
        self.diagnostics.clear()
        return self.ros.spin_until(
            lambda: any(
                condition(status)
                for array in self.diagnostics
                for status in array.status
                if status.hardware_id == self.node
            )
        )

    def trigger(self, service: str) -> Any:
        return self.ros.call(f'/{self.name}/{service}', Trigger)


@pytest.fixture(scope='module')
def rig(ros: Ros) -> Rig:
    return Rig(ros, 'patient', PATIENT)


@pytest.fixture(autouse=True)
def at_rest(request: pytest.FixtureRequest) -> None:
    if 'rig' in request.fixturenames:
        assert request.getfixturevalue('rig').trigger('reset').success


def stamp(message: JointState) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_states_stream_with_names_and_increasing_stamps(rig: Rig) -> None:
    rig.states.clear()
    assert rig.ros.spin_until(lambda: len(rig.states) >= 200)
    for state in rig.states:
        assert list(state.name) == ['pendulum', 'disk']
        assert len(state.position) == len(state.velocity) == len(state.effort) == 2
        assert state.position[0] == pytest.approx(math.pi)
        assert list(state.effort) == [0.0, 0.0]
    steps = np.diff([stamp(state) for state in rig.states])
    assert (steps > 0).all()
    assert np.median(steps) == pytest.approx(0.005, rel=0.2)


def test_a_command_turns_the_disk_and_saturates(rig: Rig) -> None:
    rig.command(['disk'], [0.004])
    assert rig.until(lambda s: s.effort[1] == 0.004 and s.velocity[1] > 0.1)
    rig.command(['other', 'disk'], [9.0, -1.0])
    assert rig.until(lambda s: s.effort[1] == -0.02 and s.effort[0] == 0.0)


def test_the_motion_is_that_of_the_equations(rig: Rig) -> None:
    """From stamps and states alone: the energy of the free pendulum is constant."""
    plant = RotaryPendulum()
    assert rig.trigger('push').success
    rig.states.clear()
    assert rig.ros.spin_until(lambda: len(rig.states) >= 100)
    energies = [plant.energy(np.array([*s.position, *s.velocity])) for s in rig.states[10:]]
    assert np.ptp(energies) < 1e-8
    moved = [s for s in rig.states if abs(s.position[0] - math.pi) > 1e-3]
    assert moved


def test_malformed_commands_are_ignored_with_a_reason(ros: Ros) -> None:
    rig = Rig(ros, 'malformed', PATIENT)
    rig.command(['arm'], [0.01])
    words = "joint_command ignored: it must name joint 'disk' once, but its names are: arm"
    assert ros.spin_until(lambda: words in rig.process.output)
    rig.command(['disk'], [math.nan])
    rig.command(['disk'], [])
    assert rig.status(lambda s: {v.key: v.value for v in s.values}['commands refused'] == '3')
    assert all(s.effort[1] == 0.0 for s in rig.states)
    rig.process.end_cleanly()


def test_no_command_for_the_time_out_switches_the_torque_off(ros: Ros) -> None:
    rig = Rig(ros, 'hasty', {'command_timeout': 0.2})
    rig.states.clear()
    rig.command(['disk'], [0.003])
    driven = [0.003, 0.0]
    assert ros.spin_until(lambda: [e for e, _ in _changes(rig.states)][-2:] == driven), (
        rig.process.output
    )
    (begin, end) = [at for _, at in _changes(rig.states)][-2:]
    # Command and time-out fall between two states each; a busy machine makes it longer.
    assert end - begin > 0.1
    words = 'no command for 0.2 s (command_timeout): actuators off'
    assert ros.spin_until(lambda: words in rig.process.output)


def _changes(states: list[JointState]) -> list[tuple[float, float]]:
    """Torque and first stamp of every stretch of constant torque."""
    found: list[tuple[float, float]] = []
    for state in states:
        if not found or found[-1][0] != state.effort[1]:
            found.append((state.effort[1], stamp(state)))
    return found


def test_push_and_reset(rig: Rig) -> None:
    response = rig.trigger('push')
    assert response.success
    assert response.message == 'pushed the pendulum with 0.0002 N m s'
    assert rig.until(lambda s: abs(s.velocity[0]) > 0.1)
    response = rig.trigger('reset')
    assert response.success
    assert 'initial state' in response.message
    assert rig.until(
        lambda s: [*s.position, *s.velocity] == pytest.approx([math.pi, 0.0, 0.0, 0.0])
    )


def test_parameters_act_at_once_and_wrong_ones_are_refused(rig: Rig) -> None:
    ros, node = rig.ros, rig.node
    assert ros.set_parameters(node, initial__theta=0.5, limits__torque=0.001) == ['', '']
    assert rig.trigger('reset').success
    rig.command(['disk'], [0.01])
    assert rig.until(lambda s: s.effort[1] == 0.001)
    refused = ros.set_parameter_mapping(
        node,
        {
            'plant.mass': -1.0,
            'noise.theta': math.nan,
            'mismatch': 1.0,
            'limits.torque': 0.0,
            'rate': 50.0,
            'initial.theta': 'up',
        },
    )
    for reason, name in zip(
        refused,
        ('plant.mass', 'noise.theta', 'mismatch', 'limits.torque', 'rate', 'initial.theta'),
        strict=True,
    ):
        assert name in reason
        assert len(reason.splitlines()) == 1
    assert ros.set_parameters(node, initial__theta=math.pi, limits__torque=0.02) == ['', '']


def test_constants_that_make_no_rig_together_are_refused(rig: Rig) -> None:
    # Each value is allowed, but a point mass on a massless arm leaves the equations singular.
    inertias = ('disk', 'y', 'z')
    reasons = [
        rig.ros.set_parameter_mapping(rig.node, {f'plant.inertia.{name}': 1e-300})[0]
        for name in inertias
    ]
    assert reasons[:2] == ['', '']
    assert 'do not make a rig' in reasons[2]
    assert rig.ros.set_parameter_mapping(
        rig.node, {'plant.inertia.disk': 2.334e-4, 'plant.inertia.y': 2.7e-7}
    ) == ['', '']


def test_noise_is_measured_and_the_disk_beyond_its_limit_is_reported(ros: Ros) -> None:
    parameters = {
        'noise.theta': 0.01,
        'initial.psi': 2.5,
        'mismatch': 0.05,
        'mismatch_seed': 3,
    }
    rig = Rig(ros, 'noisy', parameters)
    assert rig.status(
        lambda s: (
            s.level == DiagnosticStatus.WARN
            and 'disk at 2.500 rad, beyond limits.disk_angle = 2 rad' in s.message
        )
    )
    assert ros.spin_until(lambda: len(rig.states) > 300)
    thetas = np.array([s.position[0] for s in rig.states])
    assert thetas.mean() == pytest.approx(math.pi, abs=0.005)
    assert thetas.std() == pytest.approx(0.01, rel=0.3)
    rig.process.end_cleanly()


def test_a_wrong_value_at_the_start_is_reported_and_its_default_kept(ros: Ros) -> None:
    rig = Rig(ros, 'wrong', {'plant.mass': -1.0, 'plant.colour': 'red'})
    assert rig.status(
        lambda s: s.level == DiagnosticStatus.ERROR and "'plant.mass' = -1.0" in s.message
    )
    assert "'plant.colour' is unknown" in rig.process.output
    assert 'Traceback' not in rig.process.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_ends_cleanly_on_a_signal(ros: Ros, number: signal.Signals) -> None:
    rig = Rig(ros, f'ending{int(number)}', {})
    assert rig.process.end(number) == 0
    assert 'Traceback' not in rig.process.output


def test_slow_motion(ros: Ros) -> None:
    """At a tenth of the speed the pendulum covers a tenth of its velocity in the clock's time."""
    rig = Rig(ros, 'slow', {'real_time_factor': 0.1, 'disturbance.impulse': 1e-4})
    assert rig.trigger('push').success
    assert rig.until(lambda s: abs(s.velocity[0]) > 0.1)
    assert ros.spin_until(lambda: len(rig.states) > 50)
    moving = [s for s in rig.states if abs(s.velocity[0]) > 0.1]
    times = np.array([stamp(s) for s in moving])
    angles = np.array([s.position[0] for s in moving])
    velocities = np.array([s.velocity[0] for s in moving])
    means = 0.5 * (velocities[1:] + velocities[:-1])
    # The median: a stalled process leaves time out.
    ratio = np.median(np.diff(angles) / np.diff(times) / means)
    assert ratio == pytest.approx(0.1, rel=0.01)

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Problems registered by another package, and with them what a solver can do to the planner."""

from __future__ import annotations

from collections.abc import Iterator
import math
import os
from pathlib import Path
import signal
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from trajectory_msgs.msg import JointTrajectory

ENTRY_POINTS = """[tdm_planner.problems]
slow_swing_up = third_party_problems:SlowSwingUp
failing_swing_up = third_party_problems:FailingSwingUp
cart = third_party_problems:Cart
homing_cart = third_party_problems:HomingCart
not_a_problem = third_party_problems:CartStart
missing_module = no_such_module:Problem
"""


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder as pip leaves it: the module, its problems registered by metadata."""
    folder = tmp_path_factory.mktemp('site')
    module = Path(__file__).with_name('third_party_problems.py')
    (folder / module.name).write_text(module.read_text())
    metadata = folder / 'third_party-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(ENTRY_POINTS)
    return folder


class Planners:
    """Starts planners in namespaces of their own, and ends each with its test."""

    def __init__(self, ros: Ros, site: Path) -> None:
        self.ros = ros
        self.path = os.pathsep.join([str(site), ros.environment['PYTHONPATH']])
        self.started: list[NodeProcess] = []

    def start(self, namespace: str, parameters: dict[str, Any]) -> NodeProcess:
        defaults = {'start.source': 'parameters', 'solver.deadline': 5.0}
        process = self.ros.start(
            'tdm_planner.nodes.planner',
            {**defaults, **parameters},
            namespace=namespace,
            environment={'PYTHONPATH': self.path},
        )
        self.started.append(process)
        return process

    def plan(self, namespace: str) -> tuple[bool, dict[str, Any]]:
        return self.ros.trigger(f'/{namespace}/plan')


@pytest.fixture
def planners(ros: Ros, site: Path) -> Iterator[Planners]:
    made = Planners(ros, site)
    yield made
    for process in made.started:
        if process.running:
            process.end_cleanly()


def status(received: list[Any], name: str) -> Any:
    """Return the newest diagnostic status called `name`."""
    found = [s for array in received for s in array.status if s.name == name]
    return found[-1] if found else None


def test_while_one_request_is_solved_everything_else_is_served(
    ros: Ros, planners: Planners
) -> None:
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray)
    planners.start('slow', {'problem': 'slow_swing_up', 'thinking': 2.0, 'limits.torque': 0.09})
    first = ros.request('/slow/plan', Trigger)
    name = '/slow/planner: planning'

    def planning() -> bool:
        newest = status(diagnostics, name)
        return newest is not None and newest.message == 'planning'

    assert ros.spin_until(planning)
    done, answer = planners.plan('slow')
    assert not done
    assert answer['code'] == 'BUSY'
    assert ros.set_parameters('/slow/planner', thinking=0.1) == ['']
    assert not first.done()
    assert ros.spin_until(first.done)
    assert first.result().success
    assert planners.plan('slow')[0]
    assert ros.spin_until(lambda: status(diagnostics, name).message == 'plan 2 in force')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_request_under_way_does_not_hold_the_end_up(
    ros: Ros, planners: Planners, number: signal.Signals
) -> None:
    namespace = f'ended_{number.name.lower()}'
    process = planners.start(namespace, {'problem': 'slow_swing_up', 'thinking': 60.0})
    ros.request(f'/{namespace}/plan', Trigger)
    assert ros.spin_until(lambda: planners.plan(namespace)[1]['code'] == 'BUSY')
    assert process.end(number, timeout=5.0) == 0
    assert 'Traceback' not in process.output


def test_failures_have_their_codes_and_show_in_the_diagnostics(
    ros: Ros, planners: Planners
) -> None:
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray)
    process = planners.start('failing', {'problem': 'failing_swing_up', 'limits.torque': 0.09})
    expected = {
        'crash': ('INTERNAL', 'ZeroDivisionError: a bug in the solver', 2),
        'verification': ('VERIFICATION_FAILED', 'the replay misses the goal', 1),
        'infeasible': ('INFEASIBLE', 'the torque is too weak', 1),
    }
    for failure, (code, reason, level) in expected.items():
        ros.set_parameters('/failing/planner', failure=failure)
        assert planners.plan('failing') == (False, {'code': code, 'reason': reason})
        assert f'no plan: {code}: {reason}' in process.output
        message = f'{code}: {reason}'

        def shown(wanted: str = message) -> bool:
            newest = status(diagnostics, '/failing/planner: planning')
            return newest is not None and newest.message == wanted

        assert ros.spin_until(shown)
        assert status(diagnostics, '/failing/planner: planning').level == bytes([level])
    ros.set_parameters('/failing/planner', failure='not')
    assert planners.plan('failing')[0]
    assert ros.spin_until(
        lambda: status(diagnostics, '/failing/planner: planning').level == b'\x00'
    )
    newest = status(diagnostics, '/failing/planner: planning')
    figures = {item.key: item.value for item in newest.values}
    assert newest.message == 'plan 1 in force'
    assert newest.hardware_id == '/failing/planner'
    assert figures['requests'] == '4'
    assert figures['failures'] == '3'
    assert figures['age of joint_states [s]'] == 'never received'
    assert float(figures['duration [s]']) > 0.3
    assert float(figures['margin of disk_angle']) > 0
    assert figures['worst margin'].endswith(')')
    assert process.output.count('Traceback') == 1  # of the one that is a fault of the program
    assert process.output.count("raise ZeroDivisionError('a bug") == 1
    assert process.end() == 0


def test_a_problem_of_another_kind_is_served_by_names(ros: Ros, planners: Planners) -> None:
    planners.start('cart', {'problem': 'cart', 'force': 4})
    done, answer = planners.plan('cart')
    assert done
    assert answer['duration'] == pytest.approx(1.0)
    assert answer['summary'] == 'there in two strokes'
    states = ros.subscribe('/cart/trajectory', JointTrajectory, LATCHED)
    controls = ros.subscribe('/cart/controls', JointTrajectory, LATCHED)
    assert ros.spin_until(lambda: bool(states and controls))
    assert list(states[0].joint_names) == ['position', 'velocity']
    assert [list(point.positions) for point in states[0].points] == [[1, 0], [0.5, -2], [0, 0]]
    assert [list(point.effort) for point in controls[0].points] == [[-4], [4], [4]]
    assert nanoseconds_of(states[0].points[1].time_from_start) == 500_000_000


def test_a_problem_of_another_kind_plans_from_the_measured_state(
    ros: Ros, planners: Planners
) -> None:
    planners.start('carts', {'problem': 'cart', 'start.source': 'measured'})
    assert planners.plan('carts')[1]['code'] == 'NO_STATE'
    publisher = ros.publisher('/carts/joint_states', JointState)
    state = JointState(name=['position'], position=[-2.0])
    pending = ros.request('/carts/plan', Trigger)
    assert ros.publish_until(lambda: publisher.publish(state), pending.done)
    assert pending.result().success, pending.result().message
    states = ros.subscribe('/carts/trajectory', JointTrajectory, LATCHED)
    assert ros.spin_until(lambda: bool(states))
    assert states[0].points[0].positions[0] == -2.0


def test_a_problem_with_nothing_to_measure_is_planned_from_parameters(planners: Planners) -> None:
    planners.start('homing', {'problem': 'homing_cart', 'start.source': 'measured'})
    done, answer = planners.plan('homing')
    assert done, answer


@pytest.mark.parametrize(
    ('problem', 'says'),
    [
        (
            'pendulum_swingup',
            "parameter 'problem' = 'pendulum_swingup' is not allowed: must be one of "
            'pendulum_swing_up, robot_formation, cart, failing_swing_up, homing_cart, '
            'missing_module, not_a_problem, slow_swing_up (did you mean pendulum_swing_up?)',
        ),
        ('3', "parameter 'problem' = 3 is not allowed: must be a string"),
        ('missing_module', "ModuleNotFoundError: No module named 'no_such_module'"),
        ('not_a_problem', 'is not a subclass of tdm_planner.problems.Problem'),
    ],
)
def test_a_problem_that_cannot_be_loaded_ends_the_node(
    ros: Ros, planners: Planners, problem: str, says: str
) -> None:
    process = planners.start('fatal', {'problem': problem})
    assert process.process.wait(30.0) == 2
    (line,) = process.output.splitlines()
    assert line.startswith('fatal: ')
    assert says in line


def test_wrong_values_at_the_start_are_said_until_they_are_corrected(
    ros: Ros, planners: Planners
) -> None:
    wrong = {'limits.torque': 0, 'limits.torqe': 0.09, 'method': 'magic'}
    process = planners.start('wrong', wrong)
    done, answer = planners.plan('wrong')
    assert not done
    assert answer['code'] == 'INVALID_PROBLEM'
    assert "parameter 'limits.torque' = 0 is not allowed" in answer['reason']
    assert "parameter 'method' = 'magic' is not allowed" in answer['reason']
    assert "parameter 'limits.torqe' is unknown: did you mean limits.torque" in process.output
    assert (
        ros.set_parameters('/wrong/planner', limits__torque=0.09, method='switching') == [''] * 2
    )
    assert planners.plan('wrong')[0]


def test_values_that_contradict_each_other_at_the_start(ros: Ros, planners: Planners) -> None:
    planners.start('contradiction', {'plant.inertia.disk': 1e250})
    assert planners.plan('contradiction')[1]['code'] == 'INVALID_PROBLEM'
    corrected = ros.set_parameter_mapping(
        '/contradiction/planner', {'plant.inertia.disk': 2.334e-4, 'limits.torque': 0.09}
    )
    assert corrected == ['', '']
    assert planners.plan('contradiction')[0]


def test_replanning_while_a_plan_is_in_force(ros: Ros, planners: Planners) -> None:
    parameters = {'replan.rate': 5, 'replan.delay': 1.0, 'limits.torque': 0.09}
    planners.start('replan', {**parameters, 'start.delay': 0.6})
    publisher = ros.publisher('/replan/joint_states', JointState)
    states = ros.subscribe('/replan/trajectory', JointTrajectory, LATCHED)
    ros.spin_for(0.5)
    assert not states
    hanging = JointState(name=['pendulum', 'disk'], position=[math.pi, 0.1], velocity=[0.0, 0.0])
    end = time.monotonic() + 10.0
    assert planners.plan('replan')[0]
    while len(states) < 3 and time.monotonic() < end:
        publisher.publish(hanging)
        ros.spin_for(0.05)
    assert len(states) >= 3
    assert states[-1].points[0].positions[1] != 0.0
    assert ros.set_parameters('/replan/planner', replan__rate=0) == ['']
    ros.spin_for(0.5)
    count = len(states)
    for _ in range(5):
        publisher.publish(hanging)
        ros.spin_for(0.1)
    assert len(states) == count

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
from pathlib import Path
from typing import Any

import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from stepped_ros import NodeHere, Stepped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
import third_party_problems
from trajectory_msgs.msg import JointTrajectory

ENTRY_POINTS = """[tdm_planner.problems]
slow_swing_up = third_party_problems:SlowSwingUp
failing_swing_up = third_party_problems:FailingSwingUp
cart = third_party_problems:Cart
homing_cart = third_party_problems:HomingCart
not_a_problem = third_party_problems:CartStart
missing_module = no_such_module:Problem
"""
STRONG = {'limits.torque': 0.09}


class Planners:
    """Starts planners in namespaces of their own, and ends each with its test."""

    def __init__(self, ros: Stepped) -> None:
        self.ros = ros
        self.started: list[NodeHere] = []

    def start(self, namespace: str, parameters: dict[str, Any]) -> NodeHere:
        given = {'start.source': 'parameters', **parameters}
        made = self.ros.start('tdm_planner.nodes.planner', given, namespace=namespace)
        self.started.append(made)
        return made

    def plan(self, namespace: str) -> tuple[bool, dict[str, Any]]:
        return self.ros.trigger(f'/{namespace}/plan')


@pytest.fixture
def planners(ros: Stepped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Planners]:
    """Register the problems by metadata, as pip leaves it."""
    metadata = tmp_path / 'third_party-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(third_party_problems, 'time', ros.time.as_module())
    made = Planners(ros)
    yield made
    for node in made.started:
        node.end()


def test_while_one_request_is_solved_everything_else_is_served(
    ros: Stepped, planners: Planners
) -> None:
    planners.start('slow', {'problem': 'slow_swing_up', 'thinking': 2.0, **STRONG})
    first = ros.request('/slow/plan', Trigger)
    assert ros.says('/slow/planner: planning', 'planning')
    done, answer = planners.plan('slow')
    assert not done
    assert answer['code'] == 'BUSY'
    assert ros.set_parameters('/slow/planner', thinking=0.1) == ['']
    assert not first.done()
    assert ros.spin_until(first.done)
    assert first.result().success
    assert planners.plan('slow')[0]
    assert ros.says('/slow/planner: planning', 'plan 2 active')


def test_failures_have_their_codes_and_show_in_the_diagnostics(
    ros: Stepped, planners: Planners
) -> None:
    name = '/failing/planner: planning'
    planner = planners.start('failing', {'problem': 'failing_swing_up', **STRONG})
    expected = {
        'crash': ('INTERNAL', 'ZeroDivisionError: a bug in the solver', b'\x02'),
        'verification': ('VERIFICATION_FAILED', 'the replay misses the goal', b'\x01'),
        'infeasible': ('INFEASIBLE', 'the torque is too weak', b'\x01'),
    }
    for failure, (code, reason, level) in expected.items():
        ros.set_parameters('/failing/planner', failure=failure)
        assert planners.plan('failing') == (False, {'code': code, 'reason': reason})
        message = f'{code}: {reason}'
        assert f'no plan: {message}' in planner.output
        assert ros.says(name, message, level=level[0])
    ros.set_parameters('/failing/planner', failure='not')
    assert planners.plan('failing')[0]
    assert ros.says(name, 'plan 1 active', level=0)
    status = ros.statuses[name]
    assert status.hardware_id == '/failing/planner'
    figures = {item.key: item.value for item in status.values}
    assert figures['requests'] == '4'
    assert figures['failures'] == '3'
    assert figures['age of joint_states [s]'] == 'never received'
    assert float(figures['duration [s]']) > 0.3
    assert figures['plan age [s]'] == '-1'
    assert float(figures['margin of disk_angle']) > 0
    assert figures['worst margin'].endswith(')')
    assert planner.output.count('Traceback') == 1  # of the one that is a fault of the program
    assert planner.output.count("raise ZeroDivisionError('a bug") == 1
    ros.log.clear()  # or it would be taken for a crash


def test_a_problem_of_another_kind_is_served_by_names(ros: Stepped, planners: Planners) -> None:
    planners.start('cart', {'problem': 'cart', 'force': 4})
    done, answer = planners.plan('cart')
    assert done
    assert answer['duration'] == pytest.approx(1.0)
    assert answer['summary'] == 'there in two strokes'
    states = ros.subscribe('/cart/trajectory', JointTrajectory, LATCHED)
    assert ros.meet(lambda: bool(states))
    assert list(states[0].joint_names) == ['position', 'velocity', 'force']
    positions = [list(point.positions[:2]) for point in states[0].points]
    assert positions == [[1, 0], [0.5, -2], [0, 0]]
    assert [point.effort[2] for point in states[0].points] == [-4, 4, 0]  # at last for no time
    assert nanoseconds_of(states[0].points[1].time_from_start) == 500_000_000
    # Measured, it waits for its state.
    ros.set_parameters('/cart/planner', start__source='measured')
    assert planners.plan('cart')[1]['code'] == 'NO_STATE'
    pending = ros.request('/cart/plan', Trigger)
    state = JointState(name=['position'], position=[-2.0])
    ros.publisher('/cart/joint_states', JointState).publish(state)
    assert ros.spin_until(pending.done)
    assert pending.result().success, pending.result().message
    ros.settle()
    assert states[-1].points[0].positions[0] == -2.0


def test_a_problem_with_nothing_to_measure_is_planned_from_parameters(planners: Planners) -> None:
    planners.start('homing', {'problem': 'homing_cart', 'start.source': 'measured'})
    done, answer = planners.plan('homing')
    assert done, answer


@pytest.mark.parametrize(
    ('problem', 'says'),
    [
        (
            'pendulum_swingup',
            'slow_swing_up, or a stated problem such as my_module:MyP',
        ),
        ('3', "parameter 'problem' = 3 is not allowed: must be a string"),
        ('not_a_problem', 'is not a subclass of tdm_planner.problems.Problem'),
    ],
)
def test_without_its_problem_there_is_no_node(planners: Planners, problem: str, says: str) -> None:
    with pytest.raises(InvalidProblem) as error:
        planners.start('fatal', {'problem': problem})
    assert says in str(error.value)

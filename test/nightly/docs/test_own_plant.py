# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A worked plant, installed from a folder of its own, in `tdm plan` and in the planner node."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from pages import install_own_plant
import pytest
from rclpy.time import Time
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from tdm_planner.nodes.messages import LATCHED, nanoseconds_of
from trajectory_msgs.msg import JointTrajectory


@pytest.fixture(scope='module')
def installed(ros: Ros, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the environment of a process that finds the worked plant."""
    folder = tmp_path_factory.mktemp('site')
    install_own_plant(folder)
    return {'PYTHONPATH': os.pathsep.join([str(folder), ros.environment['PYTHONPATH']])}


def test_tdm_plan(ros: Ros, installed: dict[str, str], tmp_path: Path):
    file = tmp_path / 'plan.json'
    options = ['--set', 'start.x=3.0', '--set', 'solver.deadline=20.0', '-o', str(file)]
    done = ros.run('tdm_planner.cli', ['plan', 'double_integrator', *options], installed)
    assert done.process.wait(120.0) == 0, done.output
    plan = json.loads(file.read_text())
    assert plan['problem'] == 'double_integrator'
    assert plan['verification']['ok']
    assert plan['states']['x'][0] == 3.0
    assert abs(plan['states']['x'][-1]) < 1e-9
    assert 2 * 3.0**0.5 < plan['duration'] < 1.05 * 2 * 3.0**0.5


def start_planner(
    ros: Ros, installed: dict[str, str], namespace: str, **parameters: Any
) -> NodeProcess:
    default = {'problem': 'double_integrator', 'start.source': 'parameters', 'start.x': 3.0}
    return ros.start(
        'tdm_planner.nodes.planner',
        {**default, 'solver.deadline': 5.0, **parameters},
        namespace=namespace,
        environment=installed,
    )


def test_planner_service(ros: Ros, installed: dict[str, str]):
    start_planner(ros, installed, 'student')
    success, answer = ros.trigger('/student/plan')
    assert success, answer
    assert 2 * 3.0**0.5 < answer['duration'] < 1.05 * 2 * 3.0**0.5


def test_a_plan_is_reviewed_on_the_way(ros: Ros, installed: dict[str, str]) -> None:
    """A plant that follows its plan is left alone; one that was pushed away is planned for."""
    parameters = {'start.x': 30.0, 'replan.rate': 5.0, 'replan.delay': 1.5, 'free': 3}
    process = start_planner(ros, installed, 'pushed', **parameters)
    plans = ros.subscribe('/pushed/trajectory', JointTrajectory, LATCHED)
    states = ros.publisher('/pushed/joint_states', JointState)
    success, answer = ros.trigger('/pushed/plan')
    assert success, answer
    assert ros.spin_until(lambda: bool(plans))
    start = nanoseconds_of(plans[0].header.stamp)
    times = [nanoseconds_of(point.time_from_start) * 1e-9 for point in plans[0].points]
    planned = np.array([point.positions for point in plans[0].points])
    away = 0.0

    def follow(until: float) -> None:
        """Be where the plan leads, and further by `away` m, until `until` s after its start."""
        clock = ros.node.get_clock()
        while (now := clock.now().nanoseconds) < start + until * 1e9 and len(plans) == 1:
            elapsed = (now - start) * 1e-9
            x, v = (float(np.interp(elapsed, times, column)) for column in planned.T)
            message = JointState(name=['x', 'v'], position=[x + away, v])
            message.header.stamp = Time(nanoseconds=now).to_msg()
            states.publish(message)
            ros.spin_for(0.02)

    follow(until=3.0)
    assert len(plans) == 1, process.output
    away = 3.0
    follow(until=9.0)
    assert len(plans) > 1, process.output
    elapsed = (nanoseconds_of(plans[1].header.stamp) - start) * 1e-9
    expected = float(np.interp(elapsed, times, planned[:, 0])) + away
    first, last = plans[1].points[0].positions, plans[1].points[-1].positions
    assert first[0] == pytest.approx(expected, abs=0.3)
    assert last[0] == pytest.approx(0.0, abs=1e-6)

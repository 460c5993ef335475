# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A plant of one's own in closed loop: planner, tracker and plant from one class, by messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from marker_checks import check_markers, Scene
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.markers import LIFETIME
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.problems.registry import load_problem
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

GALLERY = Path(__file__).resolve().parents[2] / 'docs' / 'plants'
LOOPS = {  # module:Class, whether its end can be held, largest deviation there as a share
    'acrobot:Acrobot': (True, 0.02),
    'ball_and_beam:BallAndBeam': (True, 0.02),
    'crane:Crane': (True, 0.02),
    'moon_lander:MoonLander': (True, 0.02),
    'satellite:Satellite': (True, 0.02),
    'overtaking:Overtaking': (False, 0.02),
}


@pytest.fixture(autouse=True)
def _gallery(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(GALLERY)


class Loop:
    """The three nodes of a stated problem in a namespace."""

    def __init__(self, ros: Stepped, problem: str, **plant: Any) -> None:
        self.ros = ros
        self.problem = load_problem(problem)()
        self.nodes = [
            ros.start('tdm_sim.stated_plant', {'problem': problem, **plant}, namespace='own'),
            ros.start('tdm_planner.nodes.tracker', {'kind': problem}, namespace='own'),
            ros.start(
                'tdm_planner.nodes.planner',
                {'problem': problem, 'start.source': 'parameters'},
                namespace='own',
            ),
        ]
        self.states = ros.subscribe('/own/joint_states', JointState)
        self.plans = ros.subscribe('/own/trajectory', JointTrajectory)

    def run_to(self, instant: int) -> None:
        assert self.ros.spin_until(lambda: self.ros.now >= instant, timeout=200.0)

    def fly(self, hold: float) -> tuple[np.ndarray, np.ndarray]:
        """Plan, follow, hold so long [s]; deviations from the end as shares, there and last."""
        done, answer = self.ros.trigger('/own/plan')
        assert done, answer
        assert self.ros.spin_until(lambda: bool(self.plans))
        plan = self.plans[-1]
        points = np.array([point.positions for point in plan.points])
        ranges = np.maximum(np.ptp(points, axis=0), 0.01 * np.ptp(points, axis=0).max())
        start = plan.header.stamp.sec * 10**9 + plan.header.stamp.nanosec
        last = plan.points[-1].time_from_start
        end = start + last.sec * 10**9 + last.nanosec
        found = []
        for instant in (end, end + round(hold * 1e9)):
            self.run_to(instant)
            state = np.array(self.states[-1].position)
            found.append(np.abs(state - points[-1]) / ranges)
        return found[0], found[1]

    def end(self) -> None:
        for node in self.nodes:
            node.end_cleanly()


@pytest.mark.parametrize('problem', LOOPS)
def test_a_stated_plant_is_simulated_tracked_and_held(ros: Stepped, problem: str) -> None:
    held, allowed = LOOPS[problem]
    loop = Loop(ros, problem, mismatch=0.02)
    there, later = loop.fly(5.0 if held else 0.0)
    assert there.max() < 5 * allowed
    assert later.max() < (allowed if held else 5 * allowed)
    loop.end()


def test_a_push_while_holding_is_brought_back(ros: Stepped) -> None:
    loop = Loop(ros, 'moon_lander:MoonLander')
    loop.fly(1.0)
    assert ros.call('/own/push', Trigger).success
    loop.run_to(ros.now + 5 * 10**9)
    assert np.abs(loop.states[-1].position).max() < 0.1
    loop.end()


def test_a_plant_is_drawn_in_motion_and_its_plan(ros: Stepped) -> None:
    loop = Loop(ros, 'drawn_plant:Rail')
    moving = ros.subscribe('/own/plant_markers', MarkerArray)
    plan = ros.subscribe('/own/markers', MarkerArray, LATCHED)
    there, later = loop.fly(0.5)
    assert max(there.max(), later.max()) < 0.02
    assert list(loop.states[-1].name) == list(loop.plans[-1].joint_names) == ['cart', 'u']
    for array in moving:
        check_markers(array, 'world', LIFETIME)
    shown = Scene(moving[-1])
    assert shown.names == {('limit', 0), ('body', 1), ('body', 2), ('trail', 2)}
    assert shown['body', 1].type == Marker.CUBE
    assert shown['body', 2].pose.position.x == pytest.approx(loop.states[-1].position[0], abs=0.05)
    check_markers(plan[-1], 'world', 0.0)
    way = Scene(plan[-1])
    assert way.names == {('planned_path', 2), ('goal', 1), ('goal', 2)}
    path = way['planned_path', 2].points
    assert (path[0].x, path[-1].x) == pytest.approx((-1.0, 0.0), abs=0.01)
    loop.end()


def test_a_drawing_that_fails_is_told_at_the_start(ros: Stepped) -> None:
    with pytest.raises(InvalidProblem, match='drawing fails with IndexError'):
        ros.start('tdm_sim.stated_plant', {'problem': 'drawn_plant:Blurred'}, namespace='own')


def test_a_tracker_of_nothing_known_says_what_there_is(ros: Stepped) -> None:
    with pytest.raises(Exception, match='or a stated problem such as my_module:MyProblem'):
        ros.start('tdm_planner.nodes.tracker', {'kind': 'hovercraft'}, namespace='own')

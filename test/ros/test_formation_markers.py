# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math

from marker_checks import check_markers, Scene
import numpy as np
import pytest
from tdm_planner.nodes.formation_markers import formation_markers, LONGEST_PATH
from tdm_planner.problems.formation_parameters import Arena
from visualization_msgs.msg import Marker

ARENA = Arena(length=5.0, width=3.0, obstacles=[1.0, 2.0, 0.3, 4.0, 1.0, 0.2])
GOALS = {
    'alice': np.array([1.0, 1.0, 0.5]),
    'bob': np.array([2.0, 1.0, -2.0]),
    'carol': np.array([3.0, 1.0, 3.0]),
}
WAY = np.linspace([0.5, 0.5], [3.0, 1.0], 1000)


def test_set_up_and_plan() -> None:
    array = formation_markers(ARENA, GOALS, {'carol': WAY})
    check_markers(array, 'arena', 0.0)
    assert array.markers[0].action == Marker.DELETEALL
    scene = Scene(array)
    corners = {(p.x, p.y) for p in scene['arena'].points}
    assert corners == {(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0)}
    zone = scene['obstacles', 1]
    assert (zone.pose.position.x, zone.pose.position.y, zone.scale.x) == (4.0, 1.0, 0.4)
    goal = scene['goal', 1].pose
    assert (goal.position.x, goal.position.y) == (2.0, 1.0)
    assert 2 * math.atan2(goal.orientation.z, goal.orientation.w) == pytest.approx(-2.0)
    ring = scene['safety_circle', 1].points
    np.testing.assert_allclose([math.hypot(p.x - 2, p.y - 1) for p in ring], 0.2)
    path = scene['planned_path', 2].points
    assert len(path) == LONGEST_PATH
    assert (path[0].x, path[-1].x) == (0.5, 3.0)
    assert {number for name, number in scene.names if name == 'planned_path'} == {2}


def test_robots_and_zones_that_are_gone_disappear() -> None:
    paths = dict.fromkeys(GOALS, WAY)
    fewer = {name: GOALS[name] for name in ('alice', 'bob')}
    last = formation_markers(Arena(), fewer, {name: WAY for name in fewer})
    scene = Scene(formation_markers(ARENA, GOALS, paths), last)
    assert scene.names == Scene(last).names
    assert ('goal', 2) not in scene.names
    assert 'obstacles' not in scene.namespaces


def test_a_zone_that_is_not_complete_is_not_drawn() -> None:
    array = formation_markers(Arena(obstacles=[1.0, 2.0, 0.3, 4.0]), {})
    check_markers(array, 'arena', 0.0)
    assert Scene(array).names == {('arena', 0), ('obstacles', 0)}

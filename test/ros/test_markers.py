# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from builtin_interfaces.msg import Time
from marker_checks import check_markers, Scene
import numpy as np
import pytest
from tdm_planner.nodes.markers import colour_of, GREY, lifetime_at, Pen, points_of, Trail
from visualization_msgs.msg import Marker, MarkerArray


def rgb(name: str) -> tuple[float, float, float]:
    colour = colour_of(name)
    return colour.r, colour.g, colour.b


def test_a_name_has_one_colour_and_numbered_names_different_ones() -> None:
    assert rgb('robot2') == rgb('robot2')
    assert len({rgb(f'robot{k}') for k in range(1, 8)}) == 7
    assert len({rgb(name) for name in ('alice', 'bob', 'carol')}) > 1
    assert colour_of('robot' + '9' * 40).a == 1.0


def test_what_the_pen_draws_is_valid_and_deletes_by_name() -> None:
    pen = Pen('map', Time(sec=3), lifetime=1.5)
    line = pen.line('way', 4, points_of(np.eye(3)), GREY, 0.1)
    ball = pen.solid('ball', 0, Marker.SPHERE, GREY, (1.0, 2.0, 3.0), (4.0, 5.0))
    first = MarkerArray(markers=[line, ball, pen.text('note', 0, 'hello', (0.0, 1.0, 2.0), 0.2)])
    check_markers(first, 'map', 1.5)
    assert all(marker.header.stamp.sec == 3 for marker in first.markers)
    assert (ball.pose.position.x, ball.pose.position.y, ball.pose.position.z) == (4.0, 5.0, 0.0)
    scene = Scene(first, MarkerArray(markers=[pen.delete('way', 4)]))
    assert scene.names == {('ball', 0), ('note', 0)}
    scene.apply(MarkerArray(markers=[pen.delete_all(), line]))
    assert scene.names == {('way', 4)}


@pytest.mark.parametrize('rate', [0.1, 1.0, 25.0, 100.0])
def test_what_moves_is_visible_until_the_next_message_and_not_much_longer(rate) -> None:
    assert 2 / rate < lifetime_at(rate) <= max(0.5, 5 / rate)


def test_a_trail_keeps_its_distance_and_forgets() -> None:
    trail = Trail(age=1.0, spacing=0.1)
    for k in range(301):
        trail.add(10_000_000 * k, 0.01 * k, 0.0, 0.0)
    found = [point.x for point in trail.points]
    np.testing.assert_allclose(found, np.arange(2.0, 3.05, 0.1))
    trail.add(10_000_000, 7.0, 0.0, 0.0)  # the clock went back
    assert [point.x for point in trail.points] == [7.0]
    trail.clear()
    assert trail.points == []

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What every MarkerArray must satisfy for a viewer to draw it, and a viewer's memory."""

import math

from visualization_msgs.msg import Marker, MarkerArray

# Which of the scale's components a kind of marker reads.
SCALES = {Marker.CUBE: 'xyz', Marker.CYLINDER: 'xyz', Marker.SPHERE: 'xyz',
          Marker.LINE_STRIP: 'x', Marker.TEXT_VIEW_FACING: 'z'}  # fmt: skip


def check_markers(array: MarkerArray, frame: str, lifetimes: dict[str, float] | float) -> None:
    """Assert that every marker can be drawn; `lifetimes` are in s, by namespace or for all."""
    assert array.markers
    seen: set[tuple[str, int]] = set()
    for marker in array.markers:
        name = (marker.ns, marker.id)
        assert marker.header.frame_id == frame, name
        assert marker.action in (Marker.ADD, Marker.DELETE, Marker.DELETEALL), name
        place, q = marker.pose.position, marker.pose.orientation
        assert all(map(math.isfinite, (place.x, place.y, place.z))), place
        assert math.isclose(math.hypot(q.x, q.y, q.z, q.w), 1.0, abs_tol=1e-9), q
        if marker.action == Marker.DELETEALL:
            assert not seen, 'what is deleted must be deleted first'
            continue
        assert name not in seen, f'{name} is there twice'
        seen.add(name)
        assert marker.ns
        if marker.action == Marker.ADD:
            expected = lifetimes if isinstance(lifetimes, float) else lifetimes[marker.ns]
            assert marker.lifetime.sec + 1e-9 * marker.lifetime.nanosec == expected, name
            check_drawing(marker)


def check_drawing(marker: Marker) -> None:
    assert all(getattr(marker.scale, axis) > 0.0 for axis in SCALES[marker.type]), marker
    for place in (marker.scale, *marker.points):
        assert all(math.isfinite(getattr(place, axis)) for axis in 'xyz'), marker
    for colour in (marker.color, *marker.colors):
        assert 0.0 < colour.a <= 1.0, marker.ns
        assert all(0.0 <= getattr(colour, part) <= 1.0 for part in 'rgb')
    assert len(marker.colors) in (0, len(marker.points))
    lined = marker.type == Marker.LINE_STRIP
    assert (len(marker.points) >= 2) == bool(marker.points) == lined, marker.ns
    assert bool(marker.text) == (marker.type == Marker.TEXT_VIEW_FACING)


class Scene:
    """What a viewer shows after it has received messages; lifetimes are left out."""

    def __init__(self, *arrays: MarkerArray) -> None:
        self.markers: dict[tuple[str, int], Marker] = {}
        for marker in (marker for array in arrays for marker in array.markers):
            if marker.action == Marker.DELETEALL:
                self.markers.clear()
            elif marker.action == Marker.DELETE:
                self.markers.pop((marker.ns, marker.id), None)
            else:
                self.markers[marker.ns, marker.id] = marker

    def __getitem__(self, key: tuple[str, int] | str) -> Marker:
        return self.markers[(key, 0) if isinstance(key, str) else key]

    @property
    def names(self) -> set[tuple[str, int]]:
        return set(self.markers)

    @property
    def namespaces(self) -> set[str]:
        return {namespace for namespace, _ in self.markers}

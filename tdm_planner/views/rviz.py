# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Configurations of RViz 2 for the pendulum and for robots of any names, in any namespace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tdm_planner.views import absolute
import yaml

_PLUGIN = 'rviz_default_plugins/'


def pendulum_rviz(namespace: str = 'pendulum') -> str:
    """Return the configuration for the pendulum: an orbit around the rig in the frame `world`."""
    displays = [
        _grid(cell=0.05, cells=10, height=-0.16),
        _markers('Plan', absolute(namespace, 'markers'), latched=True),
        _markers('Plant', absolute(namespace, 'plant_markers')),
        {
            'Class': _PLUGIN + 'RobotModel',
            'Name': 'URDF',
            'Alpha': 0.5,
            'Collision Enabled': False,
            'Description File': '',
            'Description Source': 'Topic',
            'Description Topic': _topic(absolute(namespace, 'robot_description'), latched=True),
            'Enabled': True,
            'Mass Properties': {'Inertia': False, 'Mass': False},
            'TF Prefix': '',
            'Update Interval': 0,
            'Value': True,
            'Visual Enabled': True,
        },
    ]
    view = {
        'Class': _PLUGIN + 'Orbit',
        'Name': 'Current View',
        'Distance': 0.6,
        'Focal Point': {'X': 0, 'Y': 0, 'Z': 0},
        'Near Clip Distance': 0.01,
        'Pitch': 0.4,
        'Target Frame': '<Fixed Frame>',
        'Value': 'Orbit (rviz_default_plugins)',
        'Yaw': 0.6,
    }
    return _configuration('world', displays, view, [])


def robots_rviz(
    robots: Sequence[str], namespace: str = 'robots', length: float = 4.0, width: float = 4.0
) -> str:
    """
    Return the configuration for robots: the arena from above, and a goal tool for each robot.

    `length` and `width` of the arena are in m.
    """
    displays = [
        _grid(cell=1.0, cells=max(1, round(max(length, width))), x=length / 2, y=width / 2),
        _markers('Plan', absolute(namespace, 'markers'), latched=True),
    ]
    displays += [_robot(namespace, name) for name in robots]
    view = {
        'Class': _PLUGIN + 'TopDownOrtho',
        'Name': 'Current View',
        'Angle': 0,
        'Near Clip Distance': 0.01,
        'Scale': 640.0 / max(length, width),  # pixels per metre
        'Target Frame': '<Fixed Frame>',
        'Value': 'TopDownOrtho (rviz_default_plugins)',
        'X': length / 2,
        'Y': width / 2,
    }
    tools = [
        {'Class': _PLUGIN + 'SetGoal', 'Topic': _topic(absolute(namespace, name, 'goal_pose'))}
        for name in robots
    ]
    return _configuration('arena', displays, view, tools)


def _robot(namespace: str, name: str) -> dict[str, Any]:
    path = {
        'Class': _PLUGIN + 'Path',
        'Name': 'Planned poses',
        'Alpha': 0.5,
        'Buffer Length': 1,
        'Color': '200; 200; 200',
        'Enabled': False,
        'Head Diameter': 0.04,
        'Head Length': 0.04,
        'Line Style': 'Lines',
        'Pose Color': '200; 200; 200',
        'Pose Style': 'Arrows',
        'Shaft Diameter': 0.01,
        'Shaft Length': 0.08,
        'Topic': _topic(absolute(namespace, name, 'path'), latched=True),
        'Value': False,
    }
    live = _markers('Plant', absolute(namespace, name, 'plant_markers'))
    return {'Class': 'rviz_common/Group', 'Name': name, 'Enabled': True, 'Displays': [live, path]}


def _markers(name: str, topic: str, latched: bool = False) -> dict[str, Any]:
    return {
        'Class': _PLUGIN + 'MarkerArray',
        'Name': name,
        'Enabled': True,
        'Namespaces': {},
        'Topic': _topic(topic, latched),
        'Value': True,
    }


def _topic(name: str, latched: bool = False) -> dict[str, Any]:
    return {
        'Depth': 1 if latched else 5,
        'Durability Policy': 'Transient Local' if latched else 'Volatile',
        'History Policy': 'Keep Last',
        'Reliability Policy': 'Reliable',
        'Value': name,
    }


def _grid(
    cell: float, cells: int, x: float = 0.0, y: float = 0.0, height: float = 0.0
) -> dict[str, Any]:
    return {
        'Class': _PLUGIN + 'Grid',
        'Name': 'Grid',
        'Alpha': 0.3,
        'Cell Size': cell,
        'Color': '160; 160; 164',
        'Enabled': True,
        'Line Style': {'Line Width': 0.03, 'Value': 'Lines'},
        'Normal Cell Count': 0,
        'Offset': {'X': x, 'Y': y, 'Z': height},
        'Plane': 'XY',
        'Plane Cell Count': cells,
        'Reference Frame': '<Fixed Frame>',
        'Value': True,
    }


def _configuration(
    frame: str,
    displays: Sequence[Mapping[str, Any]],
    view: Mapping[str, Any],
    tools: Sequence[Mapping[str, Any]],
) -> str:
    panels = [
        {'Class': 'rviz_common/Displays', 'Name': 'Displays', 'Help Height': 0},
        {'Class': 'rviz_common/Tool Properties', 'Name': 'Tool Properties'},
        {'Class': 'rviz_common/Views', 'Name': 'Views'},
        {'Class': 'rviz_common/Time', 'Name': 'Time', 'SyncMode': 0, 'SyncSource': ''},
    ]
    everywhere = ('MoveCamera', 'Interact', 'Select', 'FocusCamera', 'Measure')
    manager = {
        'Class': '',
        'Displays': list(displays),
        'Enabled': True,
        'Global Options': {
            'Background Color': '48; 48; 48',
            'Fixed Frame': frame,
            'Frame Rate': 30,
        },
        'Name': 'root',
        'Tools': [*({'Class': _PLUGIN + name} for name in everywhere), *tools],
        'Transformation': {'Current': {'Class': _PLUGIN + 'TF'}},
        'Value': True,
        'Views': {'Current': view, 'Saved': None},
    }
    window = {
        'Height': 900,
        'Width': 1300,
        'Displays': {'collapsed': False},
        'Hide Left Dock': False,
        'Hide Right Dock': True,
    }
    document = {'Panels': panels, 'Visualization Manager': manager, 'Window Geometry': window}
    return str(yaml.dump(document, Dumper=_WithoutAliases, sort_keys=False, width=1000))


class _WithoutAliases(yaml.SafeDumper):
    """Writes repeated values in full: RViz's reader does not support aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Use no aliases."""
        return True

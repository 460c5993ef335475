# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Layouts of Foxglove (and Lichtblick) for the pendulum and for robots of any names."""

from __future__ import annotations

from collections.abc import Sequence
import json
from typing import Any

from tdm_planner.views import absolute

Panels = dict[str, dict[str, Any]]


def pendulum_foxglove(namespace: str = 'pendulum') -> str:
    """Return the layout for the pendulum: the rig, its joints, torque, errors, and the plan."""

    def topic(name: str) -> str:
        return absolute(namespace, name)

    joints, command, error = topic('joint_states'), topic('joint_command'), topic('tracking_error')
    scene = _scene(
        'world',
        [topic('markers'), topic('plant_markers')],
        {'distance': 0.6, 'phi': 65.0, 'thetaOffset': 45.0},
    )
    scene['layers']['urdf'] = {
        'layerId': 'foxglove.Urdf',
        'instanceId': 'urdf',
        'label': 'URDF (needs /tf)',
        'visible': False,
        'sourceType': 'topic',
        'topic': topic('robot_description'),
        'displayMode': 'auto',
        'framePrefix': '',
    }
    panels: Panels = {
        '3D!scene': scene,
        'Plot!angles': _plot(
            'Angles [rad]',
            {
                f'{joints}.position[0]': 'theta',
                f'{joints}.position[1]': 'psi',
            },
        ),
        'Plot!rates': _plot(
            'Rates [rad/s]',
            {f'{joints}.velocity[0]': 'theta_dot', f'{joints}.velocity[1]': 'psi_dot'},
        ),
        'Plot!torque': _plot(
            'Torque [N m]',
            {f'{joints}.effort[1]': 'applied', f'{command}.effort[0]': 'commanded'},
        ),
        'Plot!errors': _plot(
            'Tracking errors [rad]',
            {f'{error}.position[0]': 'theta', f'{error}.position[1]': 'psi'},
        ),
        **_controls(namespace, 'push', topic('push')),
    }
    plots = _stack(['Plot!angles', 'Plot!rates', 'Plot!torque', 'Plot!errors'])
    return _layout(panels, _row('3D!scene', plots, 45), _bottom())


def robots_foxglove(
    robots: Sequence[str], namespace: str = 'robots', length: float = 4.0, width: float = 4.0
) -> str:
    """
    Return the layout for robots: the arena from above, thrusts, torques, errors, the plan.

    The publish tool of the arena's panel moves the goal of the first robot; that of another one
    where the panel's setting `Publish - Topic` names it. `length` and `width` are in m.
    """

    def topic(robot: str, name: str) -> str:
        return absolute(namespace, robot, name)

    scene = _scene(
        'arena',
        [absolute(namespace, 'markers'), *(topic(name, 'plant_markers') for name in robots)],
        {
            'distance': 1.3 * max(length, width),
            'phi': 0.0,
            'perspective': False,
            'targetOffset': [length / 2, width / 2, 0.0],
            'thetaOffset': 0.0,
        },
    )
    scene['topics'].update({topic(name, 'path'): {'visible': False} for name in robots})
    scene['publish'] = {'type': 'pose', 'poseTopic': topic(robots[0], 'goal_pose')}

    def of_all(name: str, field: str) -> dict[str, str]:
        return {f'{topic(robot, name)}.{field}': robot for robot in robots}

    panels: Panels = {
        '3D!scene': scene,
        'Plot!thrust': _plot('Thrust [N]', of_all('joint_states', 'effort[0]')),
        'Plot!torque': _plot('Wheel torque [N m]', of_all('joint_states', 'effort[1]')),
        'Plot!alpha': _plot('Thruster angle [rad]', of_all('joint_states', 'position[0]')),
        'Plot!speed': _plot('Forward speed [m/s]', of_all('odom', 'twist.twist.linear.x')),
        **_controls(namespace, f'push {robots[0]}', topic(robots[0], 'push')),
    }
    plots = _stack(['Plot!thrust', 'Plot!torque', 'Plot!alpha', 'Plot!speed'])
    return _layout(panels, _row('3D!scene', plots, 55), _bottom())


def _controls(namespace: str, push: str, push_service: str) -> Panels:
    return {
        'CallService!plan': _service('plan', absolute(namespace, 'plan'), '#1a7f37'),
        'CallService!push': _service(push, push_service, '#b35900'),
        'RawMessages!summary': {
            'topicPath': f'{absolute(namespace, "plan_summary")}.data',
            'diffEnabled': False,
            'diffMethod': 'custom',
            'diffTopicPath': '',
            'showFullMessageForDiff': False,
        },
        'DiagnosticSummary!diagnostics': {
            'topicToRender': '/diagnostics',
            'minLevel': 0,
            'pinnedIds': [],
            'hardwareIdFilter': '',
            'sortByLevel': True,
        },
    }


def _bottom() -> Any:
    buttons = _stack(['CallService!plan', 'CallService!push'])
    return _row(buttons, _row('DiagnosticSummary!diagnostics', 'RawMessages!summary', 50), 20)


def _service(text: str, service: str, colour: str) -> dict[str, Any]:
    return {
        'serviceName': service,
        'requestPayload': '{}',
        'layout': 'vertical',
        'timeoutSeconds': 30,
        'editingMode': False,
        'buttonText': text,
        'buttonTooltip': f'call {service}',
        'buttonColor': colour,
        'foxglovePanelTitle': text,
    }


def _scene(frame: str, topics: Sequence[str], camera: dict[str, Any]) -> dict[str, Any]:
    return {
        'cameraState': {
            'distance': 5.0,
            'perspective': True,
            'phi': 60.0,
            'target': [0.0, 0.0, 0.0],
            'targetOffset': [0.0, 0.0, 0.0],
            'targetOrientation': [0.0, 0.0, 0.0, 1.0],
            'thetaOffset': 45.0,
            'fovy': 45.0,
            'near': 0.01,
            'far': 500.0,
            **camera,
        },
        'followMode': 'follow-none',
        'followTf': frame,
        'scene': {'transforms': {'editable': False}},
        'transforms': {},
        'topics': {topic: {'visible': True} for topic in topics},
        'layers': {
            'grid': {
                'layerId': 'foxglove.Grid',
                'instanceId': 'grid',
                'label': 'Grid',
                'visible': True,
                'frameLocked': True,
                'frameId': frame,
                'size': 10.0,
                'divisions': 10,
                'lineWidth': 1.0,
                'color': '#248eff40',
                'position': [0.0, 0.0, -0.2],
                'rotation': [0.0, 0.0, 0.0],
            }
        },
        'imageMode': {},
    }


def _plot(title: str, paths: dict[str, str]) -> dict[str, Any]:
    return {
        'paths': [
            {
                'value': path,
                'label': label,
                'enabled': True,
                'timestampMethod': 'headerStamp',
            }
            for path, label in paths.items()
        ],
        'foxglovePanelTitle': title,
        'showXAxisLabels': True,
        'showYAxisLabels': True,
        'showLegend': True,
        'legendDisplay': 'floating',
        'showPlotValuesInLegend': True,
        'isSynced': True,
        'xAxisVal': 'timestamp',
        'sidebarDimension': 240,
        'followingViewWidth': 10,
    }


def _row(first: Any, second: Any, share: float) -> dict[str, Any]:
    return {'direction': 'row', 'first': first, 'second': second, 'splitPercentage': share}


def _stack(panels: Sequence[str]) -> Any:
    """Panels of equal height, one above the other."""
    if len(panels) == 1:
        return panels[0]
    return {
        'direction': 'column',
        'first': panels[0],
        'second': _stack(panels[1:]),
        'splitPercentage': round(100.0 / len(panels), 1),
    }


def _layout(panels: Panels, top: Any, bottom: Any) -> str:
    document = {
        'configById': panels,
        'globalVariables': {},
        'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': {
            'direction': 'column',
            'first': top,
            'second': bottom,
            'splitPercentage': 78,
        },
    }
    return json.dumps(document, indent=2) + '\n'

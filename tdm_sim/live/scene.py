# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The 3-D part of the page: layers of shapes, camera, drag handles and their messages.

Every handle sets parameters of a node. A robot's goal is a pose in the plane, `formation.<robot>`
of the planner. The start of the pendulum is two rings, one an angle: `initial.*` of the simulated
plant, which is put there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
import textwrap
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.arrays import Array
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.formation.parameters import place_in_formation
from tdm_planner.problems.problem import Problem
from tdm_sim.live.geometry import Kind, Picture, Rotation, View
from tdm_sim.live.listener import PLANNING, SIMULATION
import trimesh
import viser
from viser.transforms import SO3

Values = Mapping[str, Any]
Pose = tuple[Array, Rotation]  # place (3,) [m] and attitude

UP = np.array([0.0, 0.0, 1.0])
Pulled = Callable[[int, tuple[float, ...], tuple[float, ...]], None]
_MESHES: Mapping[str, Callable[[], Any]] = {
    'cylinder': lambda: trimesh.creation.cylinder(radius=1.0, height=1.0, sections=32),
    'ball': lambda: trimesh.creation.icosphere(subdivisions=3, radius=1.0),
    'box': lambda: trimesh.creation.box(),
}
_LINE = 2.5  # px
# Colours of many shapes at once are sent as light, not as the screen has them.
_SHARES = np.arange(256) / 255
_LINEAR = np.round(255 * np.where(
    _SHARES < 0.04045, _SHARES / 12.92, ((_SHARES + 0.055) / 1.055) ** 2.4
)).astype(np.uint8)  # fmt: skip
_LIGHT = 0.35  # of the surroundings; more makes colours pale
_LETTERS = 40  # in a line of a sentence
_NEAR, _FAR = 0.01, 100.0  # what the camera sees, in sizes of what is drawn


class DragHandle(NamedTuple):
    """
    Something to drag, and the parameters of a node that it sets.

    `moves` is `pose` (in the plane, and about the vertical) or `turn` (about its own z). `role` is
    that of the nodes whose parameters they are: the planner, or simulated plants, which are reset.
    `pose(values)` is where it is for parameters by name; `values_at(pose, values)` are the
    parameters that put it at a pose.
    """

    name: str
    moves: Literal['pose', 'turn']
    role: str
    size: float
    pose: Callable[[Values], Pose]
    values_at: Callable[[Pose, Values], dict[str, Any]]


def drag_handles_of(problem: Problem) -> list[DragHandle]:
    """Return the drag handles of a problem's plant."""
    if isinstance(problem, RobotFormation):
        return [_goal(problem, number) for number in range(len(problem.robots))]
    if isinstance(problem, PendulumSwingUp):
        return _starts(problem.plant.arm_length, 2.0 * problem.plant.com_distance)
    return []


def _goal(problem: RobotFormation, number: int) -> DragHandle:
    name, task = problem.robots[number], problem.task
    place = np.array([*task.goal[number], 0.0])
    turn = SO3.from_z_radians(float(task.goal_yaw[number])).wxyz

    def values_at(pose: Pose, values: Values) -> dict[str, Any]:
        wanted = [float(pose[0][0]), float(pose[0][1]), _yaw(pose)]
        return {f'formation.{name}': place_in_formation(problem.formation.anchor, wanted)}

    return DragHandle(
        name, 'pose', PLANNING, 1.1 * task.separation, lambda values: (place, turn), values_at
    )


def _starts(arm: float, rod: float) -> list[DragHandle]:
    """Return the rings of the pendulum's start: psi about the vertical, theta about the arm."""

    def at(values: Values, name: str) -> float:
        return float(values.get(f'initial.{name}', 0.0))

    def disk(values: Values) -> Pose:
        return np.zeros(3), SO3.from_z_radians(at(values, 'psi')).wxyz

    def disk_at(pose: Pose, values: Values) -> dict[str, Any]:
        return {'initial.psi': _nearest(_yaw(pose), at(values, 'psi'))}

    def pendulum(values: Values) -> Pose:
        along, across = _arm(at(values, 'psi'))
        theta = at(values, 'theta')
        up = math.cos(theta) * UP + math.sin(theta) * across
        axes = np.stack([up, np.cross(-along, up), -along], axis=1)
        return arm * along, SO3.from_matrix(axes).wxyz

    def pendulum_at(pose: Pose, values: Values) -> dict[str, Any]:
        _, across = _arm(at(values, 'psi'))
        up = SO3(pose[1]).as_matrix()[:, 0]
        theta = math.atan2(float(up @ across), float(up @ UP))
        return {'initial.theta': _nearest(theta, at(values, 'theta'))}

    return [
        DragHandle('disk', 'turn', SIMULATION, 1.5 * arm, disk, disk_at),
        DragHandle('pendulum', 'turn', SIMULATION, 0.9 * rod, pendulum, pendulum_at),
    ]


def _yaw(pose: Pose) -> float:
    return float(SO3(pose[1]).compute_yaw_radians())


def _arm(psi: float) -> tuple[Array, Array]:
    """Return the directions along the arm, and across it as the pendulum falls for theta > 0."""
    c, s = math.cos(psi), math.sin(psi)
    return np.array([c, s, 0.0]), np.array([-s, c, 0.0])


def _nearest(angle: float, before: float) -> float:
    """Return the angle [rad] on the turn that is nearest to what it was."""
    return before + math.remainder(angle - before, math.tau)


def pulled(
    problem: Problem, values: Values, state: Array, start: Sequence[float], end: Sequence[float]
) -> dict[str, Any]:
    """
    Return the plant's parameters with which a push goes where its body was pulled.

    `values` are the plant's parameters, `state` (nx,) is that of the vehicle that was pulled from
    `start` to `end` [m]. Nothing for a plant whose pushes have no direction.
    """
    way = np.subtract(end, start)
    if isinstance(problem, RobotFormation):
        return {'disturbance.direction': math.atan2(way[1], way[0])}
    if isinstance(problem, PendulumSwingUp):
        _, across = _arm(float(state[1]))
        impulse = abs(float(values['disturbance.impulse']))
        return {'disturbance.impulse': math.copysign(impulse, float(way @ across))}
    return {}


Dragged = Callable[[DragHandle, Pose], None]


class Layer:
    """A picture under a name; what changes is sent, in few messages."""

    def __init__(self, server: viser.ViserServer, name: str, pulled: Pulled | None = None) -> None:
        self._server, self._name, self._pulled = server, name, pulled
        self._shown: dict[Kind | None, tuple[Any, int]] = {}  # copies by kind; lines by None
        self._groups: dict[Kind, NDArray[np.int_]] = {}

    def show(self, picture: Picture) -> None:
        """Show another picture."""
        for kind in [kind for kind in self._shown if kind and kind not in picture.solids]:
            self._shown.pop(kind)[0].remove()
        for kind, solids in picture.solids.items():
            self._groups[kind] = solids.groups
            self._update(
                kind,
                batched_positions=solids.places,
                batched_wxyzs=solids.rotations,
                batched_scales=solids.sizes,
                batched_colors=_LINEAR[solids.colours],
            )
        self._update(None, points=picture.lines, colors=_LINEAR[picture.line_colours])

    def _update(self, kind: Kind | None, **values: Any) -> None:
        """Show other values; what is shown is replaced where the length of the first changes."""
        count = len(next(iter(values.values())))
        handle, before = self._shown.get(kind, (None, 0))
        if handle is not None and before == count:
            for name, value in values.items():
                setattr(handle, name, value)
            return
        if handle is not None:
            self._shown.pop(kind)[0].remove()
        if count:
            add = self._add_lines if kind is None else partial(self._add_solids, kind)
            self._shown[kind] = add(**values), count

    def _add_lines(self, **values: Any) -> Any:
        return self._server.scene.add_line_segments(
            f'/{self._name}/lines', **values, thickness=_LINE, thickness_units='screen'
        )

    def _add_solids(self, kind: Kind, **values: Any) -> Any:
        shape, opacity = kind
        mesh = _MESHES[shape]()
        handle = self._server.scene.add_batched_meshes_simple(
            f'/{self._name}/{shape}_{100 * opacity:.0f}',
            vertices=mesh.vertices,
            faces=mesh.faces,
            opacity=None if opacity == 1.0 else opacity,
            flat_shading=shape != 'ball',
            lod='off',
            cast_shadow=False,
            receive_shadow=False,
            **values,
        )
        if self._pulled is not None:
            handle.on_drag(partial(self._on_drag, kind))
        return handle

    def _on_drag(self, kind: Kind, event: Any) -> None:
        if event.phase == 'end' and self._pulled is not None:
            group = int(self._groups[kind][event.instance_index or 0])
            self._pulled(group, event.start_position, event.end_position)


class HandleView:
    """A drag handle on the page, and the message beside it."""

    def __init__(
        self, server: viser.ViserServer, handle: DragHandle, pose: Pose, dragged: Dragged
    ) -> None:
        self.handle = handle
        name = f'/handles/{handle.name}'
        self._label: Any = None
        self._server, self._name = server, name
        turns = handle.moves == 'turn'
        self.control = server.scene.add_transform_controls(
            name,
            scale=handle.size,
            active_axes=(True, True, False),
            disable_axes=turns,
            disable_sliders=turns,
            depth_test=False,
            opacity=0.75,
            position=pose[0],
            wxyz=pose[1],
        )
        self._held, self._given = False, pose

        async def on_update(event: Any) -> None:  # a coroutine: phases come in their order
            self._held = event.phase != 'end'
            if event.phase != 'start':
                dragged(
                    self.handle, (np.array(event.target.position), np.array(event.target.wxyz))
                )

        self.control.on_update(on_update)

    def move(self, pose: Pose) -> None:
        """Move it, unless it is held; once dropped it stays until its parameters change."""
        changed = any(not np.allclose(*pair) for pair in zip(pose, self._given, strict=True))
        if changed and not self._held:
            self._given = pose
            self.control.position, self.control.wxyz = pose

    def tell(self, text: str) -> None:
        """Show a message beside it; '' removes it."""
        if self._label is not None:
            self._label.remove()
            self._label = None
        if text:
            self._label = self._server.scene.add_label(
                f'{self._name}/reason', textwrap.fill(text, _LETTERS), anchor='bottom-center'
            )


class Scene:
    """Everything in space: `layers` by name, handles, camera."""

    def __init__(self, server: viser.ViserServer, dragged: Dragged, pulled: Pulled) -> None:
        self._server, self._dragged = server, dragged
        self.layers = {name: Layer(server, name) for name in ('still', 'plan', 'ghost')}
        self.layers['plants'] = Layer(server, 'plants', pulled)
        self.handles: dict[str, HandleView] = {}
        server.scene.world_axes.visible = False
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(environment_intensity=_LIGHT)

    def look(self, view: View) -> None:
        """Set the camera of all browsers, present and future ones."""
        cameras: list[Any] = [self._server.initial_camera]
        cameras += [client.camera for client in self._server.get_clients().values()]
        for camera in cameras:
            camera.position, camera.look_at = view.camera, view.target
            camera.near, camera.far = _NEAR * view.size, _FAR * view.size

    def show_handles(self, handles: Mapping[str, tuple[DragHandle, Pose]]) -> None:
        """Show exactly these handles, each at its pose."""
        for name in [name for name in self.handles if name not in handles]:
            self.handles.pop(name).control.remove()
        for name, (handle, pose) in handles.items():
            if name in self.handles:
                self.handles[name].handle = handle
                self.handles[name].move(pose)
            else:
                self.handles[name] = HandleView(self._server, handle, pose, self._dragged)

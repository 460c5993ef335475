# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The page: connects the nodes (`listener`), the display (`scene`, `panel`) and the operations."""

from __future__ import annotations

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.drawing import way_of
from tdm_planner.exceptions import TdmError
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.live.geometry import DrawingStyle, GHOST, GOAL, PATH, picture, view_on
from tdm_sim.live.listener import Listener, NodeStatus, PLANNING, ROLES, SIMULATION
from tdm_sim.live.operations import Operations, Recordings
from tdm_sim.live.panel import Panel, Slider, slider_of
from tdm_sim.live.rig import Chart, History, Rig, SOLVING
from tdm_sim.live.scene import drag_handles_of, DragHandle, Pose, Scene
import viser

_TITLES = dict(zip(ROLES, ('planner', 'tracker', 'plant'), strict=True))
_PATH = 200  # points of a planned path
_PLACES = 20  # along a plan, that the camera is to see
_EVENTS = 60  # that are shown


class Page:
    """
    The page on the nodes of a namespace.

    `frame` updates the 3-D scene, `figures` the curves and `news` the texts; each is called at its
    own rate. Operations are requested in the server's threads.
    """

    def __init__(
        self, server: viser.ViserServer, listener: Listener, recordings: Recordings, title: str
    ) -> None:
        self._server, self._listener, self._recordings = server, listener, recordings
        self._rig = Rig(listener)
        self._panel = Panel(server, title)
        self._operations = Operations(self._rig, listener, recordings, self._panel.note)
        self._scene = Scene(server, self._on_dragged, self._on_pulled)
        self._panel.connect(self._operations, self._choose)
        self._width = 0.0  # of tubes; 0 until the camera is placed
        self._whole = False  # whether it was placed to see a plan; from then on it is the users'
        self._seen = -1
        self._fault = ''
        self._history = History(self._rig.view)

    def close(self) -> None:
        """Drop the waiting operations, and end a recording."""
        self._operations.close()

    # What is shown.

    def frame(self) -> None:
        """Show the present state of all vehicles."""
        rig = self._rig
        try:
            self._follow()
            another = rig.move()
            if not rig.motions:
                return
            with self._server.atomic():
                if not self._width:
                    self._place_camera([m.state for m in rig.motions.values()])
                    another = True
                if another:
                    self._show_plan()
                self._show_motion()
        except TdmError as error:  # in the parameters, or in a user's drawing
            self._fault = f'{error.code}: {error}'
        chosen = rig.motions.get(rig.chosen)
        if chosen is not None:
            self._history.add(chosen.instant * NANOSECOND, chosen.state, chosen.control)

    def figures(self) -> None:
        """Show the curves of the last seconds."""
        charts = self._history.charts(self._rig.planned(self._rig.chosen))
        if not charts:
            return
        solved = 1e3 * np.array(self._rig.solve_times)
        if solved.size > 1:
            charts.append(Chart(SOLVING, np.arange(1.0 - solved.size, 1.0), {'of a plan': solved}))
        self._panel.charts(charts)

    def news(self, fault: str = '') -> None:
        """Show the nodes' reports and faults, `fault` first."""
        listener, plan = self._listener, self._rig.plan
        nodes = {role: listener.having(role) for role in ROLES}
        silent = [node.name for found in nodes.values() for node in found if node.silent]
        faults = [fault, self._fault]
        if not nodes[PLANNING]:
            faults.append(f'waiting for a planner in {listener.space or "/"}')
        if silent:
            faults.append('no sign of life from ' + ', '.join(silent))
        rows = [(_TITLES[role], _worst(found)) for role, found in nodes.items() if found]
        if plan is not None:
            solved = f'solved in {1e3 * plan.solve_time:.0f} ms'
            rows.append((f'plan {plan.plan_id}', f'{plan.summary}; {solved}'))
        self._panel.tell(rows, '; '.join(filter(None, faults)))
        self._panel.events(list(listener.events)[::-1][:_EVENTS])
        simulated = any(not node.silent for node in nodes[SIMULATION])
        recordings = self._recordings
        self._panel.can(simulated, recordings.running, recordings.last is not None)

    def _follow(self) -> None:
        values, changes = self._listener.parameters_of(PLANNING).values, self._listener.changes
        if not values or changes == self._seen:
            return
        self._seen, self._fault = changes, ''
        if self._rig.follow(dict(values)):
            self._panel.vehicles(list(self._rig.vehicles))
            self._width, self._whole = 0.0, False
            self._history = History(self._rig.view)
        self._history.view = self._rig.view
        if self._width:
            self._show_surroundings()
        self._show_controls()

    def _show_controls(self) -> None:
        assert self._rig.problem is not None
        handles = {}
        for handle in drag_handles_of(self._rig.problem):
            values = self._listener.parameters_of(handle.role).values
            if values:
                handles[handle.name] = handle, handle.pose(values)
        self._scene.show_handles(handles)
        sliders: dict[str, Slider] = {}
        for owner in map(self._listener.parameters_of, ROLES):
            for name, descriptor in owner.descriptors.items():
                slider = slider_of(descriptor, owner.values.get(name))
                if slider is not None:
                    sliders.setdefault(name, slider)
        self._panel.sliders(sliders)
        values = self._listener.parameters_of(PLANNING).values
        self._panel.replans(values.get('replan.rate', 0.0) > 0.0)

    def _place_camera(self, states: list[Array]) -> None:
        """Point the camera at the surroundings and at a vehicle in these states (nx,)."""
        drawn = [shape for state in states for shape in self._rig.view.shapes(state)]
        view = view_on([*self._rig.view.surroundings, *drawn])
        self._width = view.width
        self._scene.look(view)
        self._show_surroundings()

    def _show_surroundings(self) -> None:
        still = [(self._rig.view.surroundings, DrawingStyle())]
        self._scene.layers['still'].show(picture(still, self._width))

    def _show_motion(self) -> None:
        rig = self._rig
        plants, ghosts = [], []
        for name, (state, control, instant) in rig.motions.items():
            plants.append((rig.view.shapes(state, control), DrawingStyle(rig.colour(name))))
            plan, now = rig.planned(name), instant * NANOSECOND
            if plan is not None and now < plan.end:
                ghosts.append((rig.view.shapes(plan.reference(now)), GHOST))
        self._scene.layers['plants'].show(picture(plants, self._width))
        self._scene.layers['ghost'].show(picture(ghosts, self._width))

    def _show_plan(self) -> None:
        rig = self._rig
        if rig.plan is None:
            self._scene.layers['plan'].show(picture((), self._width))
            return
        goals, paths, along = [], [], []
        for name in rig.vehicles:
            plan = rig.planned(name)
            if plan is None:
                continue
            states = plan.trajectory.states
            goals.append((rig.view.shapes(states[-1]), GOAL))
            states = states[np.linspace(0, len(states) - 1, min(_PATH, len(states))).astype(int)]
            for shape in rig.view.shapes(states):
                if shape.trail:
                    paths.append((way_of(shape, len(states)), rig.colour(name) or PATH))
            along += list(states[:: max(len(states) // _PLACES, 1)])
        if not self._whole and not rig.view.surroundings:
            self._place_camera(along)
        self._whole = True
        self._scene.layers['plan'].show(picture(goals, self._width, paths))

    def _choose(self, vehicle: str) -> None:
        if vehicle in self._rig.vehicles:
            self._rig.chosen, self._history = vehicle, History(self._rig.view)

    def _on_dragged(self, handle: DragHandle, pose: Pose) -> None:
        def told(text: str) -> None:
            if handle.name in self._scene.handles:
                self._scene.handles[handle.name].tell(text)
            self._panel.note(text)

        self._operations.drag(handle, pose, told)

    def _on_pulled(self, number: int, start: tuple[float, ...], end: tuple[float, ...]) -> None:
        names = list(self._rig.motions)
        if number < len(names):
            self._operations.pull(names[number], start, end)


def _worst(nodes: list[NodeStatus]) -> str:
    """Return what the node in the worst state says, with its namespace where there are several."""
    worst = max(nodes, key=lambda node: node.level)
    return (
        f'{worst.space.rpartition("/")[2]}: {worst.message}' if len(nodes) > 1 else worst.message
    )

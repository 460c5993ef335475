# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the live page knows of nodes, and what it has done, without a browser."""

from collections.abc import Callable
import math
from pathlib import Path

import numpy as np
import pytest
from ros_harness import Space
from stated import Cart
from stepped_ros import Stepped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_sim.live.listener import Listener, PLANNING, ROLES, SILENT, SIMULATION
from tdm_sim.live.operations import Operations, Recordings
from tdm_sim.live.rig import MARGINS, Rig, SOLVING
from tdm_sim.live.scene import drag_handles_of
from viser.transforms import SO3

SPACE = 'seen'


class Seen(Space):
    """The nodes of a pendulum, a listener, and operations whose deeds are told to `texts`."""

    def __init__(self, ros: Stepped, folder: Path) -> None:
        super().__init__(ros, SPACE)
        strong = {'limits.torque': 0.09}
        self.plant = self.start('pendulum_plant', strong)
        self.start('tracker', strong)
        self.start('planner', {**strong, 'torque_reserve': 0.0})
        self.listener = Listener(SPACE, ros._context)
        ros._executor.add_node(self.listener.node)
        self.rig = Rig(self.listener)
        self.texts: list[str] = []
        recordings = Recordings(folder, SPACE)
        self.operations = Operations(self.rig, self.listener, recordings, self.texts.append)
        self.plans = self.hear('trajectory')
        assert ros.spin_until(lambda: all(map(self.values, ROLES)))
        self.rig.follow(self.values(PLANNING))
        assert ros.spin_until(lambda: self.rig.move() or bool(self.rig.motions))

    def values(self, role: str) -> dict:
        return self.listener.parameters_of(role).values

    def state(self):
        self.rig.move()
        return self.rig.motions['pendulum'].state

    def told(self, deed: Callable[[], None]) -> str:
        """Do something by hand; returns what was told of it."""
        count = len(self.texts)

        def done() -> bool:
            self.rig.measure()
            return len(self.texts) > count

        deed()
        assert self.ros.spin_until(done, 20.0)
        return self.texts[-1]

    def close(self) -> None:
        self.operations.close()
        self.ros._executor.remove_node(self.listener.node)
        self.listener.close()


@pytest.fixture
def seen(ros: Stepped, tmp_path: Path):
    made = Seen(ros, tmp_path)
    yield made
    made.close()


def test_nodes_and_their_parameters_are_known_pushes_and_resets_are_followed(seen):
    listener = seen.listener
    plants = [f'/{SPACE}/pendulum_plant']
    assert [node.name for node in listener.having(SIMULATION)] == plants
    assert not any(node.silent for node in listener.nodes.values())
    assert seen.values(PLANNING)['limits.torque'] == 0.09
    assert listener.with_parameter('weights.theta') == [f'/{SPACE}/tracker']
    assert seen.state() == pytest.approx([math.pi, 0.0, 0.0, 0.0])
    assert seen.ros.spin_until(lambda: len(listener.events) > 0)
    before = listener.changes
    seen.ros.do(listener.set_parameters, plants, {'disturbance.impulse': 3e-4})
    values = seen.values(SIMULATION)
    assert seen.ros.spin_until(lambda: values['disturbance.impulse'] == 3e-4)
    assert listener.changes > before
    every = listener.with_parameter('limits.torque')
    assert len(every) == 3
    with pytest.raises(InvalidProblem, match=r"'limits.torque' = -1.0 is not allowed"):
        seen.ros.do(listener.set_parameters, every, {'limits.torque': -1.0})
    assert 'pushed' in seen.told(seen.operations.push)
    assert seen.ros.spin_until(lambda: abs(seen.state()[2]) > 0.1)
    assert 'initial' in seen.told(seen.operations.reset)
    assert seen.ros.spin_until(lambda: abs(seen.state()[2]) < 1e-9)
    told = seen.told(lambda: seen.operations.pull('pendulum', (0.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
    assert '-' in told
    assert seen.values(SIMULATION)['disturbance.impulse'] == pytest.approx(3e-4)
    # Of vehicles that are gone nothing is read any more.
    read = len(list(listener.states.subscriptions))
    seen.rig.problem = None
    assert seen.rig.follow(seen.values(PLANNING))
    assert len(list(listener.states.subscriptions)) == read


def test_a_start_that_is_dragged_is_planned_from_and_a_slider_acts_on_all_nodes(seen):
    assert seen.ros.change(f'/{SPACE}/tracker', 'deactivate')  # nothing moves
    handle = drag_handles_of(seen.rig.problem)[0]
    pose = np.zeros(3), SO3.from_z_radians(0.5).wxyz
    assert seen.told(lambda: seen.operations.drag(handle, pose, seen.texts.append)) == ''
    assert seen.values(SIMULATION)['initial.psi'] == pytest.approx(0.5)
    assert seen.ros.spin_until(seen.rig.move)
    states = seen.rig.planned('pendulum').trajectory.states
    assert states[0, 1] == pytest.approx(0.5, abs=0.05)
    name, before = 'limits.disk_angle', seen.rig.plan

    def change(value: float) -> str:
        return seen.told(lambda: seen.operations.change(name, value, seen.texts.append))

    assert change(2.5) == ''
    assert seen.ros.spin_until(lambda: all(seen.values(role)[name] == 2.5 for role in ROLES))
    assert seen.rig.move()
    good = seen.rig.plan
    assert good is not before
    seen.told(seen.operations.reset)
    assert 'INVALID_PROBLEM' in change(0.3)  # the start is beyond it
    assert not seen.rig.move()
    assert seen.rig.plan is good
    # A switch turns replanning on.
    assert '5 Hz' in seen.told(lambda: seen.operations.replan(True))
    assert seen.ros.spin_until(lambda: seen.values(PLANNING)['replan.rate'] == 5.0)


def test_the_page_shows_motion_plan_grips_and_curves(seen, tmp_path):
    viser = pytest.importorskip('viser')
    from tdm_sim.live.page import Page

    assert 'upright' in seen.told(seen.operations.plan)
    server = viser.ViserServer(host='127.0.0.1', port=0, verbose=False)
    page = Page(server, seen.listener, Recordings(tmp_path, SPACE), 'seen')
    try:
        page.news()  # nothing is known yet
        for number in (1, 2):
            for _ in range(20):
                seen.ros.spin_for(0.05)
                page.frame()
            plan, newest = page._rig.plan, seen.plans[-1].header.stamp
            assert (plan.plan_id, plan.start) == (number, nanoseconds_of(newest))
            reference = page._rig.planned('pendulum').reference(plan.start * 1e-9)
            assert math.cos(reference[0]) == pytest.approx(2 * number - 3, abs=0.01)
            page.figures()
            seen.plan()
        page.figures()
        page.news('a node ended')
        shown = set(server.scene._handle_from_node_name)
        assert {'/still/lines', '/plants/cylinder_100', '/plan/lines'} <= shown
        assert {'/handles/disk', '/handles/pendulum'} <= shown
        status = page._panel._status.content
        charts = {title for title, *_ in page._panel._charts}
        assert all(text in status for text in ('a node ended', 'planner', 'plan ', 'solved in'))
        assert {'theta, psi [rad]', 'torque [N m]', MARGINS, SOLVING} <= charts
        assert len(page._rig.solve_times) == 2
        assert 'limits.torque' in page._panel._sliders
        shown_handle = page._scene.handles['disk']
        before = np.array(shown_handle.control.wxyz)
        shown_handle.tell('INFEASIBLE: why')
        assert '/handles/disk/reason' in server.scene._handle_from_node_name
        shown_handle.tell('')
        assert '/handles/disk/reason' not in server.scene._handle_from_node_name
        shown_handle.move((np.zeros(3), SO3.from_z_radians(1.0).wxyz))
        assert not np.allclose(before, shown_handle.control.wxyz)
    finally:
        page.close()
        server.stop()


def test_the_plan_of_another_plant_before_is_not_shown(seen):
    assert 'upright' in seen.told(seen.operations.plan)
    assert seen.ros.spin_until(seen.rig.move)
    values = {'problem': 'stated:Cart', **Cart().to_parameters()}
    assert seen.rig.follow(values)  # of a planner that was started in the same namespace
    assert not seen.rig.move()
    assert seen.rig.plan is None


def test_a_planner_below_the_namespace_is_not_its_planner(seen):
    above = Listener('/', seen.ros._context)
    seen.ros._executor.add_node(above.node)
    try:
        assert seen.ros.spin_until(lambda: bool(above.having(SIMULATION)))
        seen.ros.spin_for(1.5)
        assert above.having(PLANNING) == []
    finally:
        seen.ros._executor.remove_node(above.node)
        above.close()


def test_a_node_that_is_gone_is_missed_and_known_again_when_it_is_back(seen):
    ros, listener = seen.ros, seen.listener
    seen.plant.end()
    gone = listener.having(SIMULATION)[0].name
    assert ros.spin_until(lambda: listener.nodes[gone].silent, SILENT + 3.0)
    seen.start('pendulum_plant', {'initial.theta': 3.0})
    assert ros.spin_until(lambda: not listener.nodes[gone].silent)
    assert ros.spin_until(lambda: gone in listener.declared)
    assert seen.values(SIMULATION)['initial.theta'] == 3.0
    assert ros.spin_until(lambda: abs(seen.state()[0] - 3.0) < 0.2)

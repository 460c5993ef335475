# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The live page: sliders, curves, tasks, shapes, camera, handles; who may look; nodes kept up."""

from collections.abc import Iterator
import math
from pathlib import Path
import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock

from hypothesis import assume, given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.cli import main
from tdm_planner.drawing import Box, Disc, Line, Shape
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.plant_views import view_of
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.trajectory import TimedTrajectory, Trajectory
from tdm_sim.live import operations, run
from tdm_sim.live.geometry import along, DrawingStyle, picture, view_on
from tdm_sim.live.listener import SIMULATION
from tdm_sim.live.operations import Recordings, TaskThread
from tdm_sim.live.panel import shown_range, slider_of
from tdm_sim.live.rig import History, MARGINS, RATE, SPAN
from tdm_sim.live.scene import drag_handles_of, pulled, Scene
from tdm_sim.processes import NodeProcesses, ProcessFailed
import viser
from viser.transforms import SO3
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

BEGIN = 1_800_000_000.0  # s, as clocks show
VIEW = view_of(PendulumSwingUp())
PATIENCE = 30.0  # s
angle = st.floats(-6.0, 6.0)


def slider(name: str, value, kind: int = 3, most: float = 1e12, **more):
    declared = {'name': name, 'type': kind, 'description': 'largest torque [N m]'}
    declared |= {'additional_constraints': 'must be in [1e-12, 1e+12] N m', 'read_only': False}
    declared['floating_point_range'] = [SimpleNamespace(from_value=0.0, to_value=most)]
    declared['integer_range'] = [SimpleNamespace(from_value=1, to_value=1000)]
    made = SimpleNamespace(**(declared | more))
    return slider_of(made, value)


def test_range_unit_and_description_come_from_the_declaration() -> None:
    found = slider('limits.torque', 0.02)
    assert (found.low, found.high) == pytest.approx((0.005, 0.08))
    assert (found.unit, found.group, found.value) == ('N m', 'limits', 0.02)
    assert found.hint == 'limits.torque: largest torque. must be in [1e-12, 1e+12] N m'
    share = slider('torque_reserve', 0.3, most=1.0, description='share for the feedback')
    assert (share.low, share.high, share.unit, share.group) == (0.0, 1.0, '', '')
    whole = slider('switching_arcs', 256, 2)
    assert all(isinstance(v, int) for v in (whole.low, whole.high, whole.step, whole.value))
    assert slider('method', 'switching', 4) is slider('goal.turns', None, 2) is None
    assert slider('limits.torque', 0.02, read_only=True) is None
    assert slider('plant.damping.disk', 0.0) is None
    for name in ('start.delay', 'solver.deadline', 'replan.rate'):
        assert slider(name, 0.5) is None


@given(st.floats(-1e6, 1e6), st.floats(-1e12, 1e12), st.floats(-1e12, 1e12))
def test_a_slider_holds_its_value_and_keeps_to_what_is_allowed(value, one, other):
    low, high = min(one, other, value), max(one, other, value)
    below, above = shown_range(value, low, high)
    assert low <= below <= value <= above <= high


def history(seconds: float) -> History:
    made = History(VIEW)
    for t in np.arange(0.0, seconds, 0.005):  # states come at 200 Hz
        made.add(BEGIN + t, np.array([t, 0.5 * t + 0.1, 1.0, 0.5]), np.array([0.012]))
    return made


def test_states_and_controls_by_unit_with_the_plan_and_the_margins() -> None:
    times = np.linspace(0.0, 2.0, 21)
    states = np.array([0.0, 0.0, 1.0, 0.5]) + times[:, None] * [1.0, 0.5, 0.0, 0.0]
    plan = Trajectory.of(VIEW.kind, times, states, np.full((21, 1), 0.01), 'linear')
    charts = history(1.0).charts(TimedTrajectory(plan, BEGIN))
    titles = ['theta, psi [rad]', 'theta_dot, psi_dot [rad/s]', 'torque [N m]', MARGINS]
    assert [chart.title for chart in charts] == titles
    angles = charts[0]
    assert list(angles.curves) == list(angles.planned) == ['theta', 'psi']
    assert angles.curves['theta'] == pytest.approx(angles.planned['theta'], abs=1e-6)
    assert angles.curves['psi'] - angles.planned['psi'] == pytest.approx(0.1, abs=1e-6)
    assert angles.x[-1] == 0.0
    assert 0.8 * RATE < angles.x.size < 1.3 * RATE
    margins = charts[-1]
    assert set(margins.curves) == {'torque', 'disk_angle'}
    assert (margins.curves['torque'] > 0.0).all()
    for chart in charts:
        for curve in (*chart.curves.values(), *chart.planned.values()):
            assert np.isfinite(curve).all()
    made = history(SPAN + 5.0)
    x = made.charts(None)[0].x
    assert -SPAN - 1.0 < x[0] < -SPAN / 2
    made.add(5.0, np.zeros(4), np.zeros(1))
    assert made.charts(None) == []


def test_a_newer_task_supersedes_one_that_waits_and_failures_are_told() -> None:
    tasks = TaskThread()
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    told: list[str] = []

    def first() -> str:
        begun.set()
        go_on.wait(PATIENCE)
        return 'first'

    tasks.submit('drag', first, told.append)
    assert begun.wait(PATIENCE)
    for number in range(5):
        tasks.submit('drag', f'drag {number}'.__str__, told.append)
    tasks.submit('push', Mock(side_effect=Infeasible('the goal is outside')), told.append)
    tasks.submit('pull', Mock(side_effect=KeyError('x')), told.append)
    tasks.submit('next', lambda: 'next', told.append)
    tasks.submit('last', lambda: '', lambda _: done.set())
    go_on.set()
    assert done.wait(PATIENCE)
    tasks.close()
    failures = ['INFEASIBLE: the goal is outside', "INTERNAL: KeyError: 'x'"]
    assert told == ['first', 'drag 4', *failures, 'next']


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_a_tube_lies_along_its_line(way: tuple[float, ...]) -> None:
    direction = np.array(way)
    assume(np.linalg.norm(direction) > 1e-3)
    axis = SO3(along(direction)).as_matrix()[:, 2]
    assert abs(axis @ direction) == pytest.approx(np.linalg.norm(direction), rel=1e-12)


def test_what_a_shape_becomes() -> None:
    shapes: list[Shape] = [
        Line(((0.0, 0.0), (3.0, 4.0))),
        Disc((1.0, 2.0), 0.5, 'reach'),
        Disc((1.0, 2.0, 3.0), 0.5),
        Box((1.0, 2.0, 3.0), (1.0, 2.0, 4.0), math.pi / 2),
        Line(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), 'limit'),
    ]
    found = picture([(shapes, DrawingStyle())], 0.1)
    assert {kind for kind, _ in found.solids} == {'cylinder', 'ball', 'box'}
    tube = found.solids['cylinder', 1.0]
    assert tube.places[0] == pytest.approx([1.5, 2.0, 0.0])
    assert tube.sizes[0] == pytest.approx([0.1, 0.1, 5.0])
    ((_, opacity),) = [kind for kind in found.solids if kind[1] < 1.0]
    assert found.solids['cylinder', opacity].sizes[0][:2] == pytest.approx([0.5, 0.5])
    assert found.solids['ball', 1.0].places[0] == pytest.approx([1.0, 2.0, 3.0])
    ahead = SO3(found.solids['box', 1.0].rotations[0]).as_matrix()[:, 0]
    assert ahead == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert found.lines == pytest.approx(np.array([[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 1, 0]]]))
    assert found.line_colours.shape == found.lines.shape


@given(st.floats(0.5, 3.5), st.floats(2.9, 3.5), st.floats(-3.0, 3.0))
def test_a_robot_s_goal_goes_where_it_is_dragged(x: float, y: float, yaw: float) -> None:
    problem = RobotFormation()
    handle = drag_handles_of(problem)[1]
    wanted = handle.values_at((np.array([x, y, 0.0]), SO3.from_z_radians(yaw).wxyz), {})
    moved = RobotFormation.from_parameters(wanted)
    place, turn = drag_handles_of(moved)[1].pose({})
    assert place == pytest.approx([x, y, 0.0])
    assert SO3(turn).as_matrix()[:2, 0] == pytest.approx([math.cos(yaw), math.sin(yaw)], abs=1e-9)
    assert list(wanted) == ['formation.robot2']


@given(angle, angle)
def test_the_pendulum_s_rings_stand_for_its_angles(theta: float, psi: float) -> None:
    values = {'initial.theta': theta, 'initial.psi': psi}
    for handle in drag_handles_of(PendulumSwingUp()):
        assert (handle.role, handle.moves) == (SIMULATION, 'turn')
        (found,) = handle.values_at(handle.pose(values), values).items()
        assert found[1] == pytest.approx(values[found[0]], abs=1e-7)


def test_a_turn_goes_on_from_the_turn_before_and_a_push_where_the_body_was_pulled() -> None:
    handle = drag_handles_of(PendulumSwingUp())[0]
    pose = np.zeros(3), SO3.from_z_radians(-3.1).wxyz
    (psi,) = handle.values_at(pose, {'initial.psi': 3.1}).values()
    assert psi == pytest.approx(2 * math.pi - 3.1)
    robots = pulled(RobotFormation(), {}, np.zeros(7), (1, 1, 0), (1, 3, 0.5))
    assert robots == {'disturbance.direction': pytest.approx(math.pi / 2)}
    values = {'disturbance.impulse': 2e-4}
    for end, sign in (((0, 1, 0), 1.0), ((0, -1, 0), -1.0)):
        found = pulled(PendulumSwingUp(), values, np.zeros(4), (0, 0, 0), end)
        assert found == {'disturbance.impulse': sign * 2e-4}


@pytest.fixture
def server() -> Iterator:
    made = run._server('127.0.0.1', 0)
    yield made
    made.stop()


def test_only_own_pages_may_ask(server) -> None:
    for host, own, others in (
        ('127.0.0.1', ('127.0.0.1', 'localhost'), ('evil.example', '192.168.1.7')),
        ('0.0.0.0', ('192.168.1.7',), ('evil.example',)),
        ('rig.local', ('rig.local',), ()),
    ):
        for origin in own + others:
            assert run._may_ask(origin, host) is (origin in own), (origin, host)
    assert run._url('::1', 8080) == 'http://[::1]:8080'
    address = f'ws://127.0.0.1:{server.get_port()}'
    words = {'subprotocols': [f'viser-v{viser.__version__}'], 'proxy': None}
    with connect(address, origin='http://localhost:8080', **words) as own_page:
        assert own_page.recv(timeout=20.0)
    evil = connect(address, origin='http://evil.example', **words)
    with evil as other, pytest.raises(ConnectionClosed):
        other.recv(timeout=20.0)


@pytest.mark.parametrize(
    ('words', 'does'),
    [
        ([], 'joins /'),
        (['/robots'], 'joins /robots'),
        (['pendulum'], 'starts /pendulum'),
        (['robots'], 'joins /robots'),  # where nodes run
        (['fleet'], 'joins /fleet'),
        (['fleets'], "no nodes run in /fleets; parameter 'problem' = 'fleets'"),
        (['robots', '--params', 'a.yaml'], "'--params' is for nodes that are started"),
        (['/robots', '--params', 'a.yaml'], "'--params' is for nodes that are started"),
    ],
    ids=str,
)
def test_a_namespace_is_joined_and_a_plant_started(words, does, tmp_path, monkeypatch, capsys):
    def told(text: str) -> None:
        raise InvalidProblem(text)

    monkeypatch.setattr(run, '_served', lambda space: told(f'joins {space}'))
    monkeypatch.setattr(run, 'nodes_run', lambda space: space in ('/robots', '/fleet'))
    monkeypatch.setattr(run, 'Nodes', lambda scene, _: told(f'starts {scene.namespace}'))
    assert main(['live', *words, '-o', str(tmp_path)]) == 2
    assert f'tdm: INVALID_PROBLEM: {does}' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('patience', 'told'), [(60.0, r'recorder\.log'), (0.0, 'no message has come in space')]
)
def test_without_a_message_nothing_is_recorded(tmp_path, monkeypatch, patience, told):
    monkeypatch.setattr(operations, '_FIRST', patience)
    begin = NodeProcesses.start
    ends = lambda self, name, *_: begin(self, name, 'calendar', ['2026'])  # noqa: E731
    monkeypatch.setattr(NodeProcesses, 'start', ends)
    made = Recordings(tmp_path, 'space')
    with pytest.raises(ProcessFailed, match=told):
        made.start()
    assert not made.running
    assert made.last is None


def test_a_recording_has_begun_whatever_is_told_after_that(tmp_path, monkeypatch):
    begin, talks = NodeProcesses.start, ['talks', []]
    said = f'{operations.RECORDING} a bag\n/x is not recorded: its type is unknown'
    (tmp_path / 'talks.py').write_text(
        f'print({said!r}, flush=True); __import__("time").sleep(60)'
    )
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    monkeypatch.setattr(NodeProcesses, 'start', lambda self, name, *_: begin(self, name, *talks))
    made = Recordings(tmp_path, 'space')
    assert made.start() == made.last
    assert made.running
    with pytest.raises(ProcessFailed, match='recorder'):  # it did not end as `tdm record` does
        made.stop()


@pytest.mark.parametrize('size', [1e-3, 1.0, 1e4])
def test_plants_of_any_size_are_in_sight(size: float, server) -> None:
    seen = view_on([Line(((0.0, 0.0, 0.0), (size, size, size)))])
    Scene(server, lambda *_: None, lambda *_: None).look(seen)
    away = np.linalg.norm(seen.camera - seen.target)
    assert server.initial_camera.near < away - size
    assert server.initial_camera.far > away + size


def test_a_node_that_ends_is_started_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, '_RESTART', 0.0)
    scene = SimpleNamespace(nodes=lambda: [('clock', 'calendar', ['2026'])])
    nodes = run.Nodes(scene, tmp_path)
    with nodes:
        first = nodes.identifiers['clock']
        told = ''
        end = time.monotonic() + 30.0
        while not told and time.monotonic() < end:
            told = nodes.keep_up()
        assert told.startswith('clock ended with exit code 0: ')
        assert nodes.identifiers['clock'] != first

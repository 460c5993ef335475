# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Who may look at the live page, and nodes that are kept up."""

from collections.abc import Iterator
from pathlib import Path
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')
viser = pytest.importorskip('viser')

from tdm_planner.cli import main  # noqa: E402
from tdm_planner.drawing import Line  # noqa: E402
from tdm_planner.exceptions import InvalidProblem  # noqa: E402
from tdm_sim.live import operations, run  # noqa: E402
from tdm_sim.live.geometry import view_on  # noqa: E402
from tdm_sim.live.operations import Recordings  # noqa: E402
from tdm_sim.live.scene import Scene  # noqa: E402
from tdm_sim.processes import NodeProcesses, ProcessFailed  # noqa: E402
from websockets.exceptions import ConnectionClosed  # noqa: E402
from websockets.sync.client import connect  # noqa: E402


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
        (['/robots', '--params', 'a.yaml'], "'--params' is for nodes that are started"),
    ],
    ids=str,
)
def test_nodes_of_a_namespace_are_joined_and_those_of_a_plant_started(
    words, does, tmp_path, monkeypatch, capsys
) -> None:
    def told(text: str) -> None:
        raise InvalidProblem(text)

    monkeypatch.setattr(run, '_served', lambda space: told(f'joins {space}'))
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

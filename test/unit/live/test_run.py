# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Who may look at the live page, and nodes that are kept up."""

from __future__ import annotations

from pathlib import Path
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')
viser = pytest.importorskip('viser')

from tdm_planner.drawing import Line  # noqa: E402
from tdm_sim.live import recordings, run  # noqa: E402
from tdm_sim.live.geometry import view_on  # noqa: E402
from tdm_sim.live.recordings import RecordingFailed, Recordings  # noqa: E402
from tdm_sim.live.scene import Scene  # noqa: E402
from tdm_sim.processes import NodeProcesses  # noqa: E402
from websockets.exceptions import ConnectionClosed  # noqa: E402
from websockets.sync.client import connect  # noqa: E402


@pytest.mark.parametrize(
    ('origin', 'host', 'may'),
    [
        ('127.0.0.1', '127.0.0.1', True),
        ('localhost', '127.0.0.1', True),
        ('evil.example', '127.0.0.1', False),
        ('192.168.1.7', '127.0.0.1', False),
        ('192.168.1.7', '0.0.0.0', True),
        ('evil.example', '0.0.0.0', False),
        ('rig.local', 'rig.local', True),
    ],
)
def test_only_own_pages_may_ask(origin: str, host: str, may: bool) -> None:
    assert run._may_ask(origin, host) is may


def test_a_page_from_elsewhere_is_turned_away() -> None:
    server = run._server('127.0.0.1', 0)
    address = f'ws://127.0.0.1:{server.get_port()}'
    words: dict[str, Any] = {'subprotocols': [f'viser-v{viser.__version__}'], 'proxy': None}
    own_page: Any = 'http://localhost:8080'
    evil_page: Any = 'http://evil.example'
    try:
        with connect(address, origin=own_page, **words) as own:
            assert own.recv(timeout=20.0)
        evil = connect(address, origin=evil_page, **words)
        with evil as other, pytest.raises(ConnectionClosed):
            other.recv(timeout=20.0)
    finally:
        server.stop()


@pytest.mark.parametrize(
    ('patience', 'told'), [(60.0, r'recorder\.log'), (0.0, 'no message has come in space')]
)
def test_without_a_message_nothing_is_recorded(tmp_path, monkeypatch, patience, told):
    """A recorder that ends at once; one that waits in vain."""
    monkeypatch.setattr(recordings, '_PATIENCE', patience)

    def start(self: NodeProcesses, name: str, module: str, words: list[str]) -> None:
        begin(self, name, 'calendar', ['2026'])

    begin = NodeProcesses.start
    monkeypatch.setattr(NodeProcesses, 'start', start)
    made = Recordings(tmp_path, 'space')
    with pytest.raises(RecordingFailed, match=told):
        made.start()
    assert not made.running
    assert made.last is None


@pytest.mark.parametrize('size', [1e-3, 1.0, 1e4])
def test_plants_of_any_size_are_in_sight(size: float) -> None:
    server = run._server('127.0.0.1', 0)
    try:
        seen = view_on([Line(((0.0, 0.0, 0.0), (size, size, size)))])
        Scene(server, lambda *_: None, lambda *_: None).look(seen)
        camera = server.initial_camera
        assert camera.near < np.linalg.norm(seen.camera - seen.target) - size
        assert camera.far > np.linalg.norm(seen.camera - seen.target) + size
    finally:
        server.stop()


def test_a_node_that_ends_is_started_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, '_RESTART', 0.0)
    scene: Any = SimpleNamespace(nodes=lambda: [('clock', 'calendar', ['2026'])])
    nodes = run.Nodes(scene, tmp_path)
    with nodes:
        first = nodes.identifiers['clock']
        told = ''
        end = time.monotonic() + 30.0
        while not told and time.monotonic() < end:
            told = nodes.keep_up()
        assert told.startswith('clock ended with exit code 0: ')
        assert nodes.identifiers['clock'] != first

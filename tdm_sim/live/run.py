# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""`tdm live`: nodes in processes of their own, or those that run, and one page on them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, redirect_stdout
import io
import ipaddress
import os
from pathlib import Path
import socket
import sys
import threading
import time
from urllib.parse import urlsplit
import webbrowser

from rclpy.context import Context
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.runtime import check_namespace, LONGEST_WAIT, make_executor
from tdm_planner.plan_files import make_folder
from tdm_sim.live.listener import Listener
from tdm_sim.live.operations import Recordings
from tdm_sim.live.page import Page
from tdm_sim.processes import make_scene, NodeProcesses, nodes_run, Scene
from tdm_sim.progress import printing
import viser

FRAME_RATE = 25.0  # Hz

_CURVES = 5  # frames between updates of the curves
_NEWS = 12  # frames between updates of what is read
_RESTART = 2.0  # s, the least time between two starts of a node
_TOLD = 30.0  # s from a restart that it is told of: a tab behind others wakes up late


def run_live(
    nodes: str, output: Path, parameters: Path | None, host: str, port: int, browser: bool
) -> None:
    """
    Serve the page until the process is interrupted.

    `nodes` are a namespace in which they run, or a plant whose nodes are started here if none run
    in its namespace. Recordings and logs go to the folder `output`.

    Raise InvalidProblem if there is no such problem, or the namespace, the parameter file or the
    address cannot be used; UnusableFile if the folder cannot be made.
    """
    _check_address(host)
    namespace, scene = _meant(nodes, parameters)
    if scene is None and parameters is not None:
        raise InvalidProblem(f"'--params' is for nodes that are started: those in {namespace} run")
    with ExitStack() as stack:
        own = None
        if scene is not None:
            os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
            make_folder(output)
            own = Nodes(scene, output / 'log')
            stack.enter_context(own)
        listener = stack.enter_context(_served(namespace))
        server = _server(host, port)
        stack.callback(server.stop)
        title = f'tdm live {namespace}'
        page = Page(server, listener, Recordings(output, namespace), title)
        stack.callback(page.close)
        address = _url(host, server.get_port())
        with printing():
            print(f'{address} (Ctrl-C ends it)', flush=True)
        if not _is_local(host):
            print(
                'tdm live: whoever reaches this computer over the network can move the plants',
                file=sys.stderr,
            )
        if browser:
            webbrowser.open(address)
        _show(page, own)


def _meant(nodes: str, parameters: Path | None) -> tuple[str, Scene | None]:
    """Return the namespace that a word means, and the scene to start there if nothing runs."""
    if nodes.startswith('/'):
        check_namespace(nodes, "'NAMESPACE'")
        return nodes, None
    try:
        scene = make_scene(nodes, parameters)
    except InvalidProblem as error:
        if not nodes_run(f'/{nodes}'):
            if parameters is not None:  # the fault may be theirs
                raise
            raise InvalidProblem(f'no nodes run in /{nodes}; {error}') from None
        return f'/{nodes}', None
    return scene.namespace, None if nodes_run(scene.namespace) else scene


def _show(page: Page, nodes: Nodes | None) -> None:
    """Draw frames at their rate; late ones are skipped."""
    number, due = 0, time.monotonic()
    while True:
        page.frame()
        if number % _CURVES == 0:
            page.figures()
        if number % _NEWS == 0:
            page.news('' if nodes is None else nodes.keep_up())
        number += 1
        due = max(due + 1.0 / FRAME_RATE, time.monotonic())
        time.sleep(max(due - time.monotonic(), 0.0))


class Nodes(NodeProcesses):
    """The nodes of a scene as processes; one that ends by itself is restarted."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        super().__init__(folder)
        self._commands = {name: (module, words) for name, module, words in scene.nodes()}
        self._started: dict[str, float] = {}
        self._told: dict[str, str] = {}
        for name in self._commands:
            self._begin(name)

    def keep_up(self) -> str:
        """Restart what has ended; returns what is to be told of it for some seconds, or ''."""
        now = time.monotonic()
        for name, code in self.ended().items():
            self._told[name] = f'{name} ended with exit code {code}: {self.last_line(name)}'
            if now - self._started[name] > _RESTART:
                self._begin(name)
        return '; '.join(t for n, t in self._told.items() if now - self._started[n] < _TOLD)

    def _begin(self, name: str) -> None:
        module, words = self._commands[name]
        self._started[name] = time.monotonic()
        self.start(name, module, words)


@contextmanager
def _served(namespace: str) -> Iterator[Listener]:
    with Context() as context:
        listener = Listener(namespace, context)
        executor = make_executor(context)
        executor.add_node(listener.node)
        ended = threading.Event()

        def serve() -> None:
            while not ended.is_set():
                executor.spin_once(timeout_sec=LONGEST_WAIT)

        thread = threading.Thread(target=serve, name='listener', daemon=True)
        thread.start()
        try:
            yield listener
        finally:
            ended.set()
            thread.join()
            executor.shutdown()
            listener.close()


def _server(host: str, port: int) -> viser.ViserServer:
    """Start the server, without the messages that it prints by itself."""
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    connections = server._websock_server

    async def only_own_pages(client: viser.infra.WebsockClientConnection) -> None:
        """Close connections of pages from elsewhere: browsers let them reach this computer."""
        connection = connections._live_connections[client.client_id]
        assert connection.request is not None
        origin = connection.request.headers.get('Origin')
        if origin is not None and not _may_ask(urlsplit(origin).hostname or '', host):
            await connection.close()

    connections.on_client_connect(only_own_pages)
    return server


def _url(host: str, port: int) -> str:
    return f'http://{f"[{host}]" if ":" in host else host}:{port}'  # of IPv6 in brackets


def _check_address(host: str) -> None:
    """Raise InvalidProblem if this computer cannot serve on an address."""
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as tried:
            tried.bind(address)
    except OSError as error:
        raise InvalidProblem(f"cannot serve on '--host' {host}: {error.strerror}") from None


def _may_ask(origin: str, host: str) -> bool:
    """Whether a page of the host `origin` is one that is served on `host`."""
    far = not _is_local(host) and _address(origin) is not None
    return far or _is_local(origin) or origin == host


def _is_local(host: str) -> bool:
    """Whether only this computer reaches an address."""
    address = _address(host)
    return address is not None and address.is_loopback


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address('127.0.0.1' if host == 'localhost' else host)
    except ValueError:
        return None

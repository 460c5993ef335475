# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A report is served to this machine alone, and nothing else is."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from ros_harness import UNHURRIED
from tdm_sim.report.viewing import make_server

SOURCE = Path(__file__).resolve().parents[3]


@pytest.fixture
def served(tmp_path):
    (tmp_path / 'secret.txt').write_text('secret')
    page = tmp_path / 'report.html'
    page.write_text('<p>page</p>')
    with make_server(page) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server, page
        server.shutdown()
        thread.join()


def test_the_page(served):
    server, page = served
    assert server.server_address[0] == '127.0.0.1'
    for path in ('', 'report.html', '?again'):
        with urlopen(f'http://127.0.0.1:{server.server_port}/{path}', timeout=10) as answer:
            assert answer.read() == b'<p>page</p>'
            assert answer.headers['Content-Type'] == 'text/html; charset=utf-8'
    page.write_text('<p>new</p>')
    with urlopen(f'http://127.0.0.1:{server.server_port}/', timeout=10) as answer:
        assert answer.read() == b'<p>new</p>'


@pytest.mark.parametrize('path', ['secret.txt', '../report.html', '%2e%2e/etc/passwd'])
def test_nothing_else(served, path):
    server, _ = served
    with pytest.raises(HTTPError, match='404'):
        urlopen(f'http://127.0.0.1:{server.server_port}/{path}', timeout=10)


def test_view_serves_until_interrupted(tmp_path):
    tdm = [sys.executable, '-m', 'tdm_planner.cli']
    environment = os.environ | {'PYTHONPATH': str(SOURCE), 'BROWSER': 'true'}
    subprocess.run(
        [*tdm, 'plan', 'pendulum', '-q', '-o', 'plan.json', *UNHURRIED],
        cwd=tmp_path,
        env=environment,
        check=True,
        timeout=120,
    )
    process = subprocess.Popen(
        [*tdm, 'report', 'plan.json', '--view'],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        line = ''
        end = time.monotonic() + 60
        while 'http://' not in line:
            assert time.monotonic() < end
            line = process.stdout.readline()
        address = next(word for word in line.split() if word.startswith('http://'))
        with urlopen(address, timeout=10) as answer:
            assert answer.read() == (tmp_path / 'report.html').read_bytes()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
    finally:
        process.kill()
        process.wait()

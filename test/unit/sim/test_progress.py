# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plain lines when piped, a live line on a terminal, nothing when quiet."""

import os
import pty
import subprocess
import sys

import pytest
from tdm_sim.progress import LiveProgress, make_progress

WORK = """
import time
from tdm_sim.progress import make_progress
with make_progress({quiet}) as progress:
    progress.phase('first [part]')
    progress.update('live only')
    time.sleep(0.5)
    progress.phase('second')
progress.line('done')
"""


def run_on_a_terminal(code):
    """Return what a terminal is sent."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, '-c', code],
        stdout=theirs,
        stderr=theirs,
        env=os.environ | {'TERM': 'xterm', 'COLUMNS': '100', 'PYTHONPATH': os.getcwd()},
    )
    os.close(theirs)
    sent = b''
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:
            break
        if not part:
            break
        sent += part
    os.close(ours)
    assert process.wait(timeout=30) == 0
    return sent.decode()


def test_piped(capsys):
    with make_progress() as progress:
        progress.phase('first')
        progress.update('live only')
        progress.line('[brackets] stay')
    lines = capsys.readouterr().out.splitlines()
    assert lines == ['[  0.0 s] first', '[brackets] stay']


def test_quiet(capsys):
    with make_progress(quiet=True) as progress:
        progress.phase('first')
        progress.update('live')
        progress.line('done')
    assert capsys.readouterr().out == ''


def test_terminal():
    sent = run_on_a_terminal(WORK.format(quiet=False))
    assert 'live only' in sent
    assert 'first [part]' in sent
    assert '\x1b[' in sent
    assert sent.rstrip().endswith('done')
    assert run_on_a_terminal(WORK.format(quiet=True)) == ''


def test_an_error_ends_the_live_line(monkeypatch):
    monkeypatch.setattr('sys.stdout.isatty', lambda: True, raising=False)
    progress = make_progress()
    assert isinstance(progress, LiveProgress)
    with pytest.raises(ZeroDivisionError), progress:
        progress.phase(f'{1 // 0}')
    assert not progress._bars.live.is_started

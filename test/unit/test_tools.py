# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the tools measure: memory, streams of messages, warnings; dead links of the pages."""

from __future__ import annotations

import math
import os
from pathlib import Path
import sys

import numpy as np
import pytest
from tools.memory import growth, MemoryRecord, resident
from tools.streams import compare


def test_memory_is_that_of_every_process_and_its_slope_that_after_the_warm_up() -> None:
    times = [float(t) for t in range(0, 3600, 60)]
    sizes = [50.0 + t if t < 600 else 100.0 + 2.0 * t / 3600.0 for t in times]
    assert growth(times, sizes, 600.0) == pytest.approx(2.0)
    assert math.isnan(growth(times, sizes, 3500.0))
    assert math.isnan(resident(2**22 + 1))
    record = MemoryRecord()
    for time in range(5):
        record.sample(float(time), {'this': os.getpid()})
    assert len(record.sizes['this']) == len(record.times) == 5
    assert min(record.sizes['this']) > 10.0
    assert math.isfinite(record.growth(0.0)['this'])


def test_what_is_lost_late_or_overtaken_is_counted() -> None:
    stamps = np.arange(100) * 0.01
    sent = np.column_stack([stamps, stamps])
    arrived = np.column_stack([stamps, stamps + 0.02])
    arrived[[40, 41]] = arrived[[41, 40]]
    stream = compare(sent, np.delete(arrived, [10, 11, 12], axis=0), 0.01, (0.0, 1.0))
    assert (stream.sent, stream.lost, stream.overtaken) == (100, 3, 1)
    assert stream.age_p50 == pytest.approx(20.0)
    assert stream.gap_worst == pytest.approx(40.0)
    assert stream.period_error_worst == pytest.approx(0.0, abs=1e-6)


def test_only_a_warning_that_names_the_rate_counts_as_told() -> None:
    pytest.importorskip('rclpy')
    from tools.load import told_slow

    slow = 'idle; commands at 40 Hz instead of 200: busy'
    assert told_slow({'level': 1, 'message': slow})
    assert not told_slow({'level': 0, 'message': slow})
    assert not told_slow({'level': 1, 'message': 'idle'})


@pytest.mark.parametrize(
    'dead', ['', 'missing.html', 'folder/other.html#elsewhere', '#bottom', 'missing.png']
)
def test_dead_links_are_found(dead: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    links = pytest.importorskip('tools.links')
    links._read.cache_clear()
    monkeypatch.setattr(sys, 'argv', ['links', str(tmp_path)])
    assert links.main() == 1  # an empty site is no success
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'index.html').write_text(
        '<a href="folder/other.html#there">a</a> <a href="https://example.org/x">b</a>'
        '<h1 id="top">c</h1> <a href="#top">d</a> <img src="picture.png">'
    )
    (tmp_path / 'folder' / 'other.html').write_text('<p id="there">e</p><a href="../">f</a>')
    (tmp_path / 'picture.png').write_bytes(b'')
    if dead:
        (tmp_path / 'third.html').write_text(f'<a href="{dead}">a</a>')
    found = links.dead_links(tmp_path)
    assert len(found) == bool(dead)
    assert all(dead in line for line in found)
    assert links.main() == len(found)

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A worker that dies, and Ctrl-C, lose nothing of a study."""

from collections.abc import Callable
from functools import partial
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from distributed import LocalCluster
import psutil
from pyarrow import csv
import pytest
from ros_harness import PATIENCE, SOURCE
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems import PendulumSwingUp
from tdm_sim.progress import Progress
from tdm_sim.study import Axis, each, run, workers
from tdm_sim.study.axes import points_of
from tdm_sim.study.study import ROWS, Trial


def squared(folder: Path, number: int) -> int:
    """Return the square; of 3 the process dies when it is first asked, of 5 always."""
    first = folder / 'asked 3'
    if number == 5 or (number == 3 and not first.exists()):
        (folder / f'asked {number}').touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def test_what_a_dead_worker_had_is_done_by_another(tmp_path):
    work = partial(squared, tmp_path)
    with workers(count=2) as client:
        found = dict(each(client, work, range(8), lost=lambda number: -number))
    assert found == {number: -5 if number == 5 else number * number for number in range(8)}


def test_the_workers_of_a_cluster_do_it_as_well():
    with workers(count=1) as client:
        address = client.scheduler.address.removeprefix('tcp://')
        table = run('pendulum_swing_up', {'start.theta': [1.0, 2.0]}, scheduler=address)
    trial = Trial(PendulumSwingUp)
    assert table['cost'].to_pylist() == [trial({'start.theta': x})['cost'] for x in (1.0, 2.0)]


class Told(Progress):
    """Calls `then` when it is told that there are no workers."""

    def __init__(self, then: Callable[[], None]) -> None:
        super().__init__(quiet=True)
        self.then = then

    def phase(self, text: str) -> None:
        if text == 'waiting for workers: the scheduler has none':
            self.then()


def test_a_cluster_gets_its_workers_later_and_must_have_the_statement(tmp_path, monkeypatch):
    own = {'n_workers': 0, 'threads_per_worker': 1, 'dashboard_address': None}
    with LocalCluster(**own, local_directory=str(tmp_path / 'scratch')) as cluster:
        address = cluster.scheduler_address
        over, told = {'start.theta': [1.0, 2.0, 3.0, 3.1]}, Told(lambda: cluster.scale(1))
        assert run('pendulum_swing_up', over, scheduler=address, progress=told).num_rows == 4
        (tmp_path / 'absent.py').write_text('from stated import Cart\n\n\nclass Own(Cart): ...\n')
        monkeypatch.syspath_prepend(tmp_path)
        with pytest.raises(InvalidProblem, match="cannot import 'absent': No module named"):
            run('absent:Own', {'limit': [9.0]}, scheduler=address)
        with workers(address) as client:  # whose process the absent module has not ended
            assert dict(each(client, abs, [-1, -2])) == {0: 1, 1: 2}
            results = each(client, abs, range(20))
            next(results)
            cluster.close()
            with pytest.raises(InvalidProblem, match='the Dask scheduler is gone'):
                list(results)


def test_what_else_fails_where_workers_import_the_statement_is_told(tmp_path, monkeypatch):
    text = "from stated import Cart\n\nopen('a table')\n\n\nclass Own(Cart): ...\n"
    (tmp_path / 'tabled.py').write_text(text)
    (tmp_path / 'a table').touch()
    monkeypatch.syspath_prepend(tmp_path)
    with workers(count=1) as client:
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InvalidProblem, match=r"cannot import 'tabled': .*No such file"):
            run('tabled:Own', {'limit': [9.0]}, scheduler=client.scheduler.address)


def test_a_killed_worker_and_ctrl_c_lose_no_row(tmp_path):
    values = tuple(-3.0 + 6.0 * k / 799 for k in range(800))
    over = ['study', 'pendulum', '--over', f'start.theta={",".join(map(repr, values))}']
    shared = {'solver.deadline': 0.4}  # fixtures give more time to plans with the default
    words = [*over, '--set', 'solver.deadline=.4', '-o', 'out', '--csv', '--processes', '2', '-q']
    command = [sys.executable, '-m', 'tdm_planner.cli', *words]
    apart = {'cwd': tmp_path, 'env': os.environ | {'PYTHONPATH': str(SOURCE)}}
    rows, end = tmp_path / 'out' / ROWS, time.monotonic() + 3 * PATIENCE
    own = {'stderr': subprocess.PIPE, 'start_new_session': True}
    with subprocess.Popen(command, **apart, **own) as study:
        while not rows.exists() or rows.read_bytes().count(b'\n') < 20:
            assert study.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        children = psutil.Process(study.pid).children()
        max(children, key=lambda child: child.memory_info().rss).kill()
        os.killpg(study.pid, signal.SIGINT)  # as a terminal does, to all of them
        _, said = study.communicate(timeout=3 * PATIENCE)
    assert (study.returncode, said) == (130, b'')
    table = tmp_path / 'out' / 'table.csv'
    assert 20 <= csv.read_csv(table).num_rows < len(values)
    subprocess.run(command, check=True, **apart)
    whole = [json.loads(line) for line in rows.read_text().splitlines()[1:]]
    whole.sort(key=lambda row: row['row'])
    assert csv.read_csv(table)['row'].to_pylist() == list(range(len(values)))
    trial, points = Trial(PendulumSwingUp, shared), points_of([Axis('start.theta', values)])
    for number in range(0, len(values), 40):
        here = trial(points[number])
        here.pop('solve_time')
        assert {name: whole[number][name] for name in here} == here

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Processes: the command line; packages, threads, files, kernels and signals of all of them."""

from contextlib import nullcontext
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from unittest.mock import Mock

from launch_stand_ins import installed
import pytest
from replays import faults
from ros_harness import MODULES, reserved_domain, ros_environment, SOURCE, UNHURRIED
from tdm_planner import parameter_files, set_up, starting
from tdm_planner.cli import main
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems import RobotFormation
from tdm_planner.starting import Interrupted, interruptible, uninterrupted

EXECUTABLES = {**MODULES, 'tdm': 'tdm_planner.cli'}
THREADS = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    others = {name: value for name, value in os.environ.items() if name not in THREADS}
    environment = {**others, **environment, 'PYTHONPATH': str(SOURCE)}
    command, told = [sys.executable, *arguments], {'capture_output': True, 'text': True}
    return subprocess.run(command, env=environment, timeout=120, **told)


def test_launch_files_need_only_what_ubuntu_has() -> None:
    """`ros2 launch` runs them in the system's Python, not in the environment of the nodes."""
    pytest.importorskip('rclpy')
    missing = ['casadi', 'daqp', 'mcap', 'numba', 'plotly', 'rosbags', 'zstandard']
    text = ''.join(path.read_text('utf-8') for path in (SOURCE / 'launch').glob('*.py'))
    text += (SOURCE / 'tdm_planner' / 'launching.py').read_text('utf-8')
    modules = set(re.findall(r'from (tdm_\w+[\w.]+) import', text)) - {'tdm_planner.launching'}
    assert 'tdm_planner.robot_nodes' in modules
    program = f'import sys; sys.modules.update(dict.fromkeys({missing}))\n'
    done = python('-c', program + ''.join(f'import {name}\n' for name in sorted(modules)))
    assert done.returncode == 0, done.stderr


def test_every_problem_is_prepared_and_one_that_cannot_be_is_named(monkeypatch, capsys):
    prepared: list[str] = []
    monkeypatch.setattr(RobotFormation, 'prepare', lambda self: prepared.append(self.name))
    for names, code in ((['robot_formation'], 0), (['theirs', 'robot_formation'], 1)):
        found = [InvalidProblem('its module is missing')] * code + [RobotFormation]
        monkeypatch.setattr(set_up, 'load_problem', Mock(side_effect=found))
        monkeypatch.setattr(set_up, 'problem_names', lambda names=names: names)
        assert set_up.main() == code
        assert prepared.pop() == 'robot_formation'
        captured = capsys.readouterr()
        assert 'kernels of robot_formation' in captured.out
        assert ('theirs cannot be prepared: its module is missing' in captured.err) == code


@pytest.mark.parametrize(
    ('name', 'program', 'said'),
    [
        *((name, f"{{'numba': None}}); from {module} import main; main()",
           "not installed: numba; .*'make setup' .* then 'colcon build' .*'pip install numba'")
          for name, module in EXECUTABLES.items()),
        ('planner', "{'rclpy': None}); import tdm_planner", "'rclpy', which is not installed"),
    ],
)  # fmt: skip
def test_executables_say_which_package_is_missing(name, program, said, tmp_path):
    script = tmp_path / name
    script.write_text(f'import sys; sys.modules.update({program}')
    done = python(str(script))
    assert (done.returncode, done.stdout) == (1, '')
    (line,) = done.stderr.splitlines()
    assert re.search(said, line)


def test_executables_and_modules_that_are_run_use_one_thread_unless_told_otherwise(tmp_path):
    pytest.importorskip('rclpy')
    tell = f'import os; print([os.environ.get(name) for name in {THREADS}])'
    (tmp_path / 'planner').write_text(f'import tdm_planner\n{tell}')
    as_module = 'import sys; sys.orig_argv = ["python", "-m", "{0}"]; import {0}\n'
    modules = 'tdm_planner.set_up', 'benchmark.pendulum'
    runs = [['-c', as_module.format(name) + tell] for name in modules]
    for words in ([str(tmp_path / 'planner')], *runs):
        assert python(*words).stdout == "['1', '1', '1']\n"
    told = python(str(tmp_path / 'planner'), **dict.fromkeys(THREADS, '2'))
    assert told.stdout == "['2', '2', '2']\n"


def make_share(prefix: Path) -> Path:
    file = prefix / 'share/tdm_planner/config/mine.yaml'
    file.parent.mkdir(parents=True)
    file.touch()
    return file


def test_a_workspace_comes_before_the_environment_before_the_sources(tmp_path, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'python'))
    config_file = parameter_files.config_file
    assert config_file('pendulum.yaml') == SOURCE / 'config' / 'pendulum.yaml'
    monkeypatch.setattr(parameter_files, '__file__', str(tmp_path / 'site-packages/a/b.py'))
    mine = make_share(tmp_path / 'python')
    assert config_file('mine.yaml') == mine
    make_share(tmp_path / 'not_indexed')
    workspace = installed(tmp_path / 'workspace', {'tdm_planner': {}})
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/not_indexed:{workspace}')
    found = config_file('pendulum.yaml')
    assert found == workspace / 'share/tdm_planner/config/pendulum.yaml'


@pytest.mark.parametrize('number', starting.SIGNALS)
def test_the_first_signal_interrupts_and_the_second_does_not_disturb(number: signal.Signals):
    before, done = signal.getsignal(number), []
    with interruptible(), uninterrupted():
        pass  # without a signal nothing happens
    assert signal.getsignal(number) is before

    def work(whole: bool):
        with interruptible():
            try:
                with uninterrupted() if whole else nullcontext():
                    signal.raise_signal(number)
                    done.append('whole')
                done.append('more')
            finally:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGTERM)
                done.append('cleaned up')

    for whole, expected in ((False, ['cleaned up']), (True, ['whole', 'cleaned up'])):
        done.clear()
        with pytest.raises(Interrupted) as found:
            work(whole)
        assert (done, found.value.code) == (expected, 128 + number)
        assert signal.getsignal(number) is before


@pytest.mark.parametrize(('given', 'handled'), [('SIG_DFL', True), ('SIG_IGN', False)])
def test_a_hang_up_is_handled_unless_it_is_ignored_as_under_nohup(given, handled):
    program = f'import signal; signal.signal(signal.SIGHUP, signal.{given})\n'
    program += 'from tdm_planner.starting import SIGNALS; print(signal.SIGHUP in SIGNALS)'
    assert python('-c', program).stdout == f'{handled}\n'


def test_signals_are_handled_before_anything_is_imported_that_takes_long(tmp_path):
    """A signal in the first tens of milliseconds ended in a traceback."""
    (tmp_path / 'tdm').write_text("""
import signal, sys
sys.modules.pop('importlib.metadata', None)
class Watch:
    def find_spec(name, *_):
        if name == 'importlib.metadata':
            print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
sys.meta_path.insert(0, Watch)
import tdm_planner
""")
    assert python(str(tmp_path / 'tdm')).stdout == 'False\n'


OURS = {
    'tdm': ('-m tdm_planner.cli record -o bag', '/opt/bin/tdm record -o bag'),
    'node': ('-m tdm_planner.nodes.planner --ros-args', '-X dev -m tdm_sim.robot_plant',
             '-m tdm_sim.stated_plant', '/opt/lib/tdm_planner/tracker'),
    '': ('/opt/bin/other record', '-m pytest record', '-m pytest planner', '-m nav.planner',
         '-c 1'),
    'module': ('-m tdm_planner.set_up',),
}  # fmt: skip


@pytest.mark.parametrize(('whose', 'line'), [(k, line) for k in OURS for line in OURS[k]])
def test_processes_of_ones_own_are_told_from_others(whose, line, monkeypatch):
    words = line.split()
    monkeypatch.setattr('sys.orig_argv', ['python', *words])
    monkeypatch.setattr('sys.argv', words if words[0][0] == '/' else ['-m'])
    assert starting.started_as() == whose


@pytest.mark.parametrize('wheels', [True, False])
def test_wheels_beside_a_sourced_installation_are_refused(wheels, tmp_path, monkeypatch):
    (tmp_path / 'opt/ros/lib/python3.12/site-packages/rclpy').mkdir(parents=True)
    (tmp_path / 'workspace').mkdir()
    monkeypatch.setattr(starting, 'find_spec', lambda name: wheels or None)
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    starting.require_one_ros()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/workspace:{tmp_path}/opt/ros')
    if not wheels:
        starting.require_one_ros()
        return
    with pytest.raises(ImportError, match=f'(?s){tmp_path}/opt/ros') as error:
        starting.require_one_ros()
    assert sys.prefix in str(error.value)


def test_an_interrupted_import_is_an_interruption():
    """An extension that is being imported makes an ImportError of what a signal raises."""

    def load():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as interrupted:
            raise ImportError('initialization failed') from interrupted

    with pytest.raises(Interrupted), interruptible():
        load()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_plan_as_users_ask_for_it_is_written_and_drawn_and_reaches_the_goal(folder, capsys):
    """By a parameter file and settings, in a process of its own; replayed from the file."""
    values = '{limits: {torque: 9e-2}, start: {source: measured, theta: 3.0}}'
    (folder / 'p.yaml').write_text(f'/**:\n  planner:\n    ros__parameters: {values}\n')
    words = ['plan', 'pendulum', '--params', 'p.yaml', '--set', 'torque_reserve=0', 'start.psi=.1']
    words += ['--set', 'solver.seed=1', *UNHURRIED]
    done = python('-m', 'tdm_planner.cli', *words, '-o', 'plan.json', '--plot', 'plan.png')
    assert done.returncode == 0, done.stderr
    assert 'upright' in done.stdout
    plan = json.loads((folder / 'plan.json').read_text())
    assert plan['verification']['ok'] is True
    assert [plan['states'][name][0] for name in ('theta', 'psi')] == [3.0, 0.1]
    assert abs(plan['controls']['torque'][0]) == pytest.approx(0.09)
    assert not faults(plan)
    assert (folder / 'plan.png').read_bytes().startswith(b'\x89PNG')
    assert main([*words, '-q', '-o', 'plan.csv']) == 0
    assert capsys.readouterr() == ('', '')


@pytest.mark.parametrize(
    ('command', 'code', 'words'),
    [
        *(
            (f'plan pendulum -o plan.json {options}', code, words)
            for options, code, *words in (
                ('--set limits.torque=-1', 2, 'limits.torque', '-1', '[1e-12, 1e+12] N m'),
                ('--set limits.torque=.nan', 2, 'limits.torque', 'nan'),
                ('--set plant.mas=1', 2, 'plant.mas', 'unknown', 'plant.mass'),
                ('--set nonsense', 2, 'nonsense', 'name=value'),
                ('--set start.psi=2.5', 2, 'start.psi', '2.5', '[-2, 2]'),
                ('--params absent.yaml', 2, 'absent.yaml', 'cannot be read'),
                ('--params ../wrong.json', 2, 'not YAML'),
                (
                    '--params ../other.yaml',
                    2,
                    'other.yaml',
                    'robot_formation',
                    'pendulum_swing_up',
                ),
                ('--set limits.torque=1e-4 --set solver.deadline=.3', 3),
                ('-o plan.txt', 2, 'plan.txt', '.json, .csv, .npz'),
                ('-o missing/plan.json', 2, 'missing'),
                ('--plot plan.bmp', 2, 'plan.bmp'),
            )
        ),
        ('demo pendulum --params ../other.yaml -o run', 2, ['is for problem', 'takes one for']),
        ('report absent', 2, ["'absent'"]),
        ('report .', 2, ["'.'", 'no recording']),
        ('report ../wrong.json', 2, ['wrong.json', 'not JSON']),
        ('report ../plan.json --namespace x', 2, ['plan.json', 'has no namespaces']),
        ('report ../plan.json -o page.pdf', 2, ['page.pdf', '.html']),
        ('report ../plan.json -o missing/page.html', 2, ['missing', 'does not exist']),
        *(
            (f'study pendulum --over start.psi=0 -o ../out -q {options}', 2, [told])
            for options, told in (
                ('--seeds 3', '--closed-loop'),
                ('--closed-loop --seeds 0', "'seeds' = 0"),
                ('--scheduler localhost', "'localhost' does not answer"),
            )
        ),
    ],
)
def test_mistakes_get_a_sentence_and_a_code(command, code, words, folder, monkeypatch, capsys):
    if command.startswith('study'):
        pytest.importorskip('distributed')
    (folder / 'wrong.json').write_text('a: [1, 2\nb: }')
    (folder / 'other.yaml').write_text('/**: {ros__parameters: {problem: robot_formation}}')
    (folder / 'plan.json').write_text('{"problem": "x", "times": [0, 1], "states": {}}')
    (folder / 'folder').mkdir()
    monkeypatch.chdir(folder / 'folder')
    assert main(command.split()) == code
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(word in line for word in words), line
    assert not (command.startswith('report') and 'INVALID_PROBLEM' in line)
    assert not list((folder / 'folder').iterdir())


@pytest.mark.parametrize(
    ('command', 'code', 'told'),
    [
        ('plan pendulum -o plan.json > /dev/full', 2, 'No space left on device'),
        ('check stated:Cart > /dev/full', 2, 'No space left on device'),
        ('report plan.json >&-', 2, ''),
    ],
)
def test_standard_output_that_cannot_be_written_or_is_closed(command, code, told, folder):
    (folder / 'plan.json').write_text('{}')
    path = os.pathsep.join([str(SOURCE), str(SOURCE / 'test')])
    line, environment = f'"{sys.executable}" -m tdm_planner.cli {command}', {'PYTHONPATH': path}
    shown = {'stderr': subprocess.PIPE, 'text': True, 'env': {**os.environ, **environment}}
    done = subprocess.run(['sh', '-c', line], timeout=120, **shown)
    assert done.returncode == code, done.stderr
    expected = (
        f'standard output cannot be written: {told}' if told else 'not a plan written by tdm'
    )
    assert re.fullmatch(f'tdm: FILE: .*{expected}\n', done.stderr), done.stderr


def test_usage_version_and_without_a_package_the_way_out_are_told(monkeypatch, capsys):
    wrong = ['live', '--port', '99999'], ['study', 'pendulum', '--processes', '-3']
    for words in ([], ['plan', 'pendulum'], *wrong, ['--version']):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == (0 if words == ['--version'] else 2)
    assert capsys.readouterr().out.startswith('tdm_planner 0.')
    commands = ('tdm_sim.live', 'tdm_sim.demo')
    for name in [name for name in sys.modules if name.startswith(commands)]:
        monkeypatch.delitem(sys.modules, name)
    for package, command, way_out in (
        ('viser', 'live', "pip install tdm_planner[live]'"),
        ('rclpy', 'demo', "this needs 'rclpy', which is not installed"),
    ):
        monkeypatch.setitem(sys.modules, package, None)
        assert main([command, 'pendulum']) == 2
        assert way_out in capsys.readouterr().err


@pytest.mark.parametrize('foreign', ['out', 'out/thesis.tex'])
def test_a_demo_refuses_wrong_speeds_and_leaves_alone_what_is_not_its_own(foreign, folder, capsys):
    pytest.importorskip('rclpy')
    for speed in ('0', '-1', '100', 'nan'):
        assert main(['demo', 'pendulum', f'--speed={speed}', '-o', 'out']) == 2
        assert "parameter 'speed'" in capsys.readouterr().err
    assert not list(folder.iterdir())
    for command in ('demo', 'live'):
        assert main([command, 'pendulum', '-o', '/proc/out']) == 2
        assert "FILE: the folder '/proc/out' cannot be made" in capsys.readouterr().err
    assert main(['live', '/pendulum', '--host', '192.0.2.1']) == 2
    assert "cannot serve on '--host' 192.0.2.1" in capsys.readouterr().err
    record = ['record', '-o', 'out']
    for words in ([*record, 'bad topic'], [*record, '--namespace', 'bad ns'], ['live', '/bad ns']):
        assert main(words) == 2
        assert 'must not contain characters' in capsys.readouterr().err
    mine = folder / foreign
    mine.parent.mkdir(exist_ok=True)
    mine.write_text('mine')
    assert main(['demo', 'pendulum', '-o', 'out']) == 2
    assert "'out'" in capsys.readouterr().err
    assert mine.read_text() == 'mine'


@pytest.mark.parametrize(
    ('command', 'mode', 'told'),
    [
        ('demo pendulum -q -o z', 0o555, "z/log' cannot be used: Permission denied"),
        ('demo pendulum -q -o z', 0, "z/bag' cannot be used: Permission denied"),
        ('live pendulum --no-browser -o z', 0o555, "z/log' cannot be used: Permission denied"),
        ('plan pendulum -o z/a.json', 0, "z/a.json' cannot be used: Permission denied"),
        ('record -o z/b', 0, "z/b' cannot be used: Permission denied"),
        ('report z', 0, "z/metadata.yaml' cannot be used: Permission denied"),
    ],
)
def test_a_folder_that_a_user_may_not_use_gets_a_sentence(command, mode, told, folder):
    """Also where root runs the tests, whom no mode holds up."""
    pytest.importorskip('rclpy')
    (folder / 'z').mkdir()
    (folder / 'z').chmod(mode)
    user = ['setpriv', '--bounding-set=-dac_override,-dac_read_search']
    words = [*(user if os.geteuid() == 0 else []), sys.executable, '-m', 'tdm_planner.cli']
    shown, places = {'capture_output': True, 'text': True}, {'PYTHONPATH': str(SOURCE)}
    with reserved_domain() as domain:
        environment = {**os.environ, **ros_environment(domain, folder), **places}
        done = subprocess.run([*words, *command.split()], env=environment, timeout=120, **shown)
    (folder / 'z').chmod(0o755)
    assert done.returncode == 2
    assert re.fullmatch(f"tdm: FILE: '.*{told}\n", done.stderr), done.stderr


def test_a_demo_without_a_verdict_says_why_there_is_none():
    pytest.importorskip('rclpy')
    from tdm_sim.demo import _unjudged
    from tdm_sim.report.mission import Event, Level, Mission

    told = 'stopped: the state is 0.5 away from the trajectory at its start'
    events = Event(0.1, Level.ERROR, '/rig/tracker', told), Event(0.2, Level.OK, 'rig', '')
    mission = Mission('rig', (), events=events, missing=('There is no plan of rig.',))
    expected = 'too little was recorded', 'There is no plan of rig.', f'/rig/tracker: {told}'
    for line, part in zip(_unjudged(mission), expected, strict=True):
        assert line.startswith(part)

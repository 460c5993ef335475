# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What README and documentation tell people to type works; the worked plants are near the optimum.

What needs ROS 2 installed, or is started by other tests, is checked against what is declared.
"""

from collections import Counter
from configparser import ConfigParser
from dataclasses import replace
import itertools
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import textwrap
from xml.etree import ElementTree

from brachistochrone import Brachistochrone, cycloid_time
import double_integrator
from landing import Landing
from landing_reference import collocation
import misprints
import numpy as np
from obstacle import RoundTheObstacle, shortest_time
import pendulum_scheme as scheme
import pytest
import robots_scheme as robots
from ros_harness import MODULES, NodeProcess, SOURCE
from tdm_planner import cli
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems import DirectSolverParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import problem_names, SHORT_NAMES
from tools.node_tables import declared_arguments, parameters_by_node
import yaml

FOUND = [*SOURCE.glob('*.md'), *(SOURCE / 'docs').rglob('*.md')]
PAGES = sorted(path for path in FOUND if '_build' not in path.parts)
EVERY_PAGE = pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(SOURCE)))
OF_OTHERS = {'cd', 'mkdir', 'git', 'sudo', 'rosdep', 'colcon', '.', 'source', 'pip', 'export',
             'python3', '.ci/run'}  # fmt: skip
SHARE = '$(ros2 pkg prefix --share tdm_planner)'  # commands are run in a folder like it


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks in a language, which may stand in lists."""
    text = page.read_text(encoding='utf-8')
    found = re.findall(rf'^( *)```{language}\n(.*?)^\1```$', text, re.DOTALL | re.MULTILINE)
    return [textwrap.dedent(block) for _, block in found]


def typed(page: Path) -> list[list[str]]:
    """Return the words of every command of the page, without the variables before it."""
    text = ''.join(blocks(page, 'sh') + blocks(page, 'console'))
    lines = text.replace('\\\n', ' ').replace('&&', '\n').replace(SHARE, '.').splitlines()
    found = [shlex.split(line, comments=True) for line in lines]
    found = [list(itertools.dropwhile(lambda word: '=' in word, words)) for words in found]
    return [words for words in found if words]


@EVERY_PAGE
def test_examples_run_or_can_be_parsed(page):
    for block in blocks(page, 'python'):
        exec(compile(block, str(page), 'exec'), {})
    for block in blocks(page, 'yaml'):
        assert yaml.safe_load(block)
    for block in blocks(page, 'xml'):
        ElementTree.fromstring(block)
    for block in blocks(page, 'ini'):
        ConfigParser().read_string(block)


@EVERY_PAGE
def test_commands_do_what_they_say(page, tmp_path, monkeypatch):
    """In order, in a folder that has the package's parameter files."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    solve = Problem.solve
    patiently = lambda problem, deadline=None, **more: solve(problem, 60.0, **more)  # noqa: E731
    monkeypatch.setattr(Problem, 'solve', patiently)
    for program, *words in typed(page):
        if [program, *words[:3]] == ['ros2', 'run', 'tdm_planner', 'tdm']:
            program, *words = words[2:]
        if program == 'cp':
            shutil.copy(*words)
        elif program == 'tdm':
            run_tdm(words)
        elif program == 'make':
            rules = (SOURCE / 'Makefile').read_text(encoding='utf-8')
            skipped = 2 if '-C' in words else 0
            for target in words[skipped:]:
                assert '=' in target or re.search(rf'^{target}:', rules, re.MULTILINE), target
        elif program == 'ros2':
            check_ros2(*words)
        else:
            assert program in OF_OTHERS, program


def run_tdm(words: list[str]) -> None:
    options = cli._parser().parse_args(words)  # exits for what is wrong
    runs = words[0] == 'plan' and options.problem in {*SHORT_NAMES, *problem_names()}
    if runs or (words[0] == 'report' and Path(words[1]).is_file()):
        assert cli.main(words) == 0, words
        for path in (options.output, getattr(options, 'plot', None)):
            assert path is None or path.stat().st_size > 0


def check_ros2(verb: str, *words: str) -> None:
    if verb == 'launch':
        declared = declared_arguments(SOURCE / 'launch' / words[1])
        assert {word.split(':=')[0] for word in words[2:]} <= set(declared), words
    elif verb == 'service':
        kinds = dict.fromkeys(('plan', 'reset', 'push'), 'std_srvs/srv/Trigger')
        kinds['plan_with'] = 'rcl_interfaces/srv/SetParametersAtomically'
        assert words[2] == kinds[words[1].rpartition('/')[2]], words
    elif verb == 'param':
        nodes = parameters_by_node().items()
        name = words[1].rpartition('/')[2]
        assert any(words[2] in specs for kind, specs in nodes if kind.split()[0] == name), words
    else:
        assert verb in ('run', 'bag', 'lifecycle', 'security'), words


def test_nodes_run_as_the_pages_say(ros, tmp_path, monkeypatch):
    """All at once, to save time: planners and plants that share a namespace only warn."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    places = SOURCE / 'docs/plants', SOURCE, os.environ.get('PYTHONPATH', '')
    variables = {'PYTHONPATH': os.pathsep.join(map(str, places))}
    lines: dict[tuple[str, ...], None] = {}
    for words in itertools.chain(*map(typed, PAGES)):
        if words[0] == 'cp':
            shutil.copy(*words[1:])
        elif words[:3] == ['ros2', 'run', 'tdm_planner'] and words[3] in MODULES:
            lines[tuple(words[3:])] = None
    assert {line[0] for line in lines} == {*MODULES}
    processes: dict[str, list[NodeProcess]] = {}  # by the name of the node
    for name, *words in lines:
        spaces = [word.removeprefix('__ns:=') for word in words if word.startswith('__ns:=')]
        made = ros.run(MODULES[name], words, variables)
        processes.setdefault(f'{"".join(spaces)}/{name}', []).append(made)
    wanted = {name: len(started) for name, started in processes.items()}

    def all_there() -> bool:
        nodes = ros.node.get_node_names_and_namespaces()
        found = Counter(f'{space.rstrip("/")}/{name}' for name, space in nodes)
        return found >= Counter(wanted)

    assert ros.spin_until(all_there, 120.0), wanted
    ros.spin_for(1.0)
    for process in itertools.chain(*processes.values()):
        assert process.running, process.output
        process.process.send_signal(signal.SIGINT)
    for process in itertools.chain(*processes.values()):
        process.end_cleanly()
        found = re.findall(r'^.*(?:\[ERROR\]|\[FATAL\]).*$', process.output, re.MULTILINE)
        # A tracker that has no plan says so.
        assert all('tracker]: idle: ' in line for line in found), process.output


# The worked plants against what is known of their optima; what the pages on the paper claim.
DIRECT = DirectSolverParameters(deadline=120.0, refine=False)
REFINED = DirectSolverParameters(deadline=120.0)


def planned(problem):
    solution = problem.solve()
    assert solution.verification.ok
    assert min(solution.verification.worst.values(), default=0.0) > -1e-4
    return solution


def test_double_integrator_approaches_the_optimum_with_every_parameter():
    times = double_integrator.table((0, 2, 4, 8, 20))
    assert times[0] == pytest.approx(np.sqrt(6.0), rel=1e-4)  # the cubic
    assert all(b < a for a, b in itertools.pairwise(times.values()))
    assert 2.0 < times[20] < 2.02
    assert times[4] < 1.05 * 2.0


def test_brachistochrone_is_the_cycloid():
    for across, down in ((2.0, 1.0), (0.5, 1.0)):
        problem = Brachistochrone(across=across, down=down, solver=DIRECT)
        best = cycloid_time(across, down, 9.81)
        assert planned(problem).cost == pytest.approx(best, rel=1e-4)
        straight = replace(problem, free=1).solve()
        slide = np.sqrt(2 * (across**2 + down**2) / (9.81 * down))
        assert straight.cost == pytest.approx(slide, rel=1e-4)


def test_round_the_obstacle():
    best = shortest_time(2.0, 1.0, 1.0)
    problem = RoundTheObstacle(solver=DIRECT)
    plain, quicker = planned(problem), planned(replace(problem, speed_factor_order=3))
    for solution in (plain, quicker):
        x, y = solution.trajectory.states.T
        assert np.hypot(x, y).min() > 1.0 - 1e-3
    assert best * (1 - 1e-4) < quicker.cost < plain.cost
    assert quicker.cost < 1.005 * best
    refined = planned(replace(problem, solver=REFINED))
    assert best * (1 - 1e-4) < refined.cost < 1.001 * best  # as the page says: .1 %


def test_landing_against_collocation():
    problem = Landing(solver=DIRECT)
    solution = planned(problem)
    start, end = solution.trajectory.states[[0, -1]]
    np.testing.assert_allclose(start, [0, 0, 60, 25, 0, 0], atol=1e-6)
    np.testing.assert_allclose(end, [500, 300, 2, 16, -0.06, 2.2], atol=1e-6)
    assert solution.parameters.size == 21
    best, finer = (collocation(problem, solution.trajectory, n).cost for n in (40, 80))
    assert best == pytest.approx(finer, rel=1e-4)  # the optimum of the problem, not of the grid
    assert finer * (1 - 1e-4) < solution.cost < 1.01 * finer
    refined = planned(replace(problem, solver=REFINED))
    assert refined.cost == pytest.approx(finer, rel=1e-3)
    quicker = replace(problem, free=3).solve().cost
    assert quicker < 0.999 * replace(problem, free=3, speed_factor_order=0).solve().cost


PLANT = RotaryPendulum()


def test_every_misprint_breaks_the_energy_balance_and_the_right_equations_are_the_plants():
    state = np.array([0.7, 0.2, -3.0, 5.0])
    expected = PLANT.derivative(state, np.array([0.01]))[2:]
    np.testing.assert_allclose(misprints.accelerations(PLANT, state, 0.01, ()), expected)
    assert misprints.energy_error(()) < 1e-9
    for name in misprints.MISPRINTS:
        assert misprints.energy_error((name,)) > 0.1, name


def test_orders_of_the_pendulums_schemes():
    switches = np.array([1.2])
    right = scheme.truth(switches)
    assert np.isnan(scheme.printed(101, switches).time)
    mended = [abs(scheme.mended(n, 1.2).time / right.time - 1) for n in (101, 401)]
    completed = [abs(scheme.printed(n, switches, True).time / right.time - 1) for n in (101, 401)]
    assert mended[1] < 1e-4
    assert mended[0] / mended[1] > 12  # second order
    assert completed[1] > 100 * mended[1]
    # The plant follows the mended one ever closer.
    errors = list(scheme.landing_errors(0.4, 0.063, (80, 160, 320)).values())
    assert errors[0] / errors[1] > 3  # second order
    assert errors[1] / errors[2] > 3


def test_virtual_arc_works_from_above_the_horizontal_not_from_hanging_with_weak_torque():
    ratios = scheme.transfers(np.array([0.8, np.pi]), np.array([0.02, 0.04]))
    assert np.isnan(ratios[:, 1]).all()
    assert (ratios[:, 0] < 1.05).all()
    assert (ratios[:, 0] > 1 - 1e-3).all()


def test_robots_scheme_misses_and_the_exact_inverse_does_not():
    for nodes in (101, 401):
        moving, resting = robots.move(velocity=0.2), robots.move()
        printed = robots.printed(moving, nodes)
        assert printed.speed_factor[1:-3] == pytest.approx(1.0, abs=0.05)
        printed = robots.printed(resting, nodes)
        assert printed.speed_factor[nodes // 2] > 1.5
        assert robots.open_loop_miss(resting, printed) > 0.5
        assert robots.open_loop_miss(resting, robots.exact(resting, nodes)) < 2e-3
    assert robots.yaw_rate_ripple(101) == pytest.approx(1.0)

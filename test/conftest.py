# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Fixtures shared by all tests; those that need ROS skip where rclpy is not installed."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
import faulthandler
import functools
import importlib.util
import os

from hypothesis import settings
import pytest
from ros_harness import ENOUGH, reserved_domain, Ros, ros_environment
from tdm_planner.starting import limit_threads

limit_threads()  # nothing above imports numpy
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
collect_ignore_glob = []
if importlib.util.find_spec('cyclonedds') is None:  # its wheels end at Python 3.13
    collect_ignore_glob.append('system/test_other_dds.py')
if None in map(importlib.util.find_spec, ('distributed', 'pyarrow')):  # of the extra `study`
    collect_ignore_glob.append('*/study/*')

# What takes longest is begun first: no process has a long file left when the others are done.
LONGEST = (
    *('test_ended', 'test_demo', 'test_recorded'),
    *('test_pendulum_swing_up', 'test_own_plant', 'test_hostile_network', 'test_tracker'),
    *('test_problems', 'test_faults', 'test_bad_statements', 'test_study', 'test_fuzz'),
    *('test_replanning', 'test_browser', 'test_prediction', 'test_robot_formation'),
)
LONGEST_TEST, LONGEST_BY_NIGHT = 600.0, 1800.0  # s
TERMINAL = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    """Let pytest-xdist hand out files in the order of the collection."""
    config.option.loadscopereorder = False
    config.stash[TERMINAL] = os.dup(2)  # while a test runs, pytest captures the other one


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator:
    """Print where a test hangs and end the process, even where the middleware never returns."""
    longest = LONGEST_BY_NIGHT if 'nightly' in item.path.parts else LONGEST_TEST
    faulthandler.dump_traceback_later(longest, exit=True, file=item.config.stash[TERMINAL])
    yield
    faulthandler.cancel_dump_traceback_later()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


# The same cases in every run, and no time limit: the machine may be busy.
settings.register_profile('same', derandomize=True, deadline=None)
settings.load_profile('same')


@pytest.fixture(scope='session', autouse=True)
def _unhurried():
    """Give plans time enough where the test states no deadline: the machine may be busy."""
    from tdm_planner.problems import Problem
    from tdm_planner.replanning.replanner import Replanner

    solve, solve_again = Problem.solve, Replanner._solve

    @functools.wraps(solve)
    def solve_unhurried(problem, deadline=None, *args, **options):
        usual = type(problem.solver).deadline
        if deadline is None and problem.solver.deadline == usual:
            deadline = ENOUGH
        return solve(problem, deadline, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Problem, 'solve', solve_unhurried)
        patch.setattr(Replanner, '_solve', lambda *asked: solve_again(*asked[:-1], ENOUGH))
        yield


@contextmanager
def _ros_domain(factory: pytest.TempPathFactory, harness: type[Ros]) -> Iterator:
    folder = factory.mktemp('ros')
    with reserved_domain() as domain, pytest.MonkeyPatch.context() as patch:
        environment = ros_environment(domain, folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        with closing(harness(domain, folder, environment)) as made:
            yield made


@pytest.fixture(scope='module')
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """Yield a ROS domain for the test module, in test/ros with a time of its own."""
    pytest.importorskip('rclpy')
    if request.path.parent.name == 'ros':
        yield request.getfixturevalue('stepped')
        return
    with _ros_domain(tmp_path_factory, Ros) as made:
        yield made


@pytest.fixture(autouse=True)
def _ended(request: pytest.FixtureRequest):
    """End the nodes that a test in test/ros has started itself; those of faults are kept."""
    here = request.path.parent.name == 'ros' and 'ros' in request.fixturenames
    here &= request.path.stem != 'test_faults'
    nodes = request.getfixturevalue('ros').nodes if here else []
    before = len(nodes)
    yield
    for node in nodes[before:]:
        node.end_cleanly()


@pytest.fixture(scope='module')
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """Yield one with a time of its own, whose nodes are in the test's process."""
    pytest.importorskip('rclpy')
    from stepped_ros import Stepped

    with _ros_domain(tmp_path_factory, Stepped) as made:
        yield made

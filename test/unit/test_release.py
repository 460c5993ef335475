# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a maintainer looks at before a release: manifest, changelog, versions, benchmark."""

from __future__ import annotations

import ast
from pathlib import Path
import re
import shutil
import sys
from xml.etree import ElementTree

from benchmark import __main__ as command
from benchmark import figures as records_of_runs
from benchmark import page, runner
from benchmark.progress import MARK
from benchmark.sections import SECTIONS
import pytest
from ros_harness import SOURCE
import tdm_planner
from tdm_planner.cli import EXTRAS
from tdm_planner.starting import REQUIRED

# What a package that is imported is called by rosdep, where not simply its name.
ROSDEP_KEYS = {
    name: f'python3-{name}'
    for name in ('hypothesis', 'matplotlib', 'numpy', 'pytest', 'rich', 'scipy', 'yaml')
}
# Not in Ubuntu's archive: `make setup` installs them.
WITHOUT_KEY = {*REQUIRED, *EXTRAS, 'trimesh'} - {*ROSDEP_KEYS}
ROS_SUFFIXES = ('_msgs', '_srvs', '_interfaces')
OURS = {'tdm_planner', 'tdm_sim', 'tools', 'benchmark', 'test', 'docs'}
SETUP = (SOURCE / 'setup.py').read_text(encoding='utf-8')
CHANGELOG = (SOURCE / 'CHANGELOG.rst').read_text(encoding='utf-8')


def imported(*folders: str) -> set[str]:
    """Top-level packages that the sources in these folders import, anywhere."""
    found: set[str] = set()
    for path in (path for folder in folders for path in (SOURCE / folder).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).split('.')[0])
    return found - set(sys.stdlib_module_names) - OURS


def test_manifest_depends_on_what_is_used_and_nothing_else():
    """Neither RViz nor rosbag2 is listed: a rig without a screen is to get no window system."""
    manifest = ElementTree.parse(SOURCE / 'package.xml').getroot()

    def depends(kind: str) -> set[str]:
        found = [str(element.text) for element in manifest.findall(kind)]
        assert len(found) == len(set(found)), found
        return set(found)

    used = imported('tdm_planner', 'tdm_sim', 'launch') - WITHOUT_KEY
    ours = depends('exec_depend')
    beside = {'python3-venv', 'robot_state_publisher'}  # for `make setup`; what launch files start
    assert ours == {ROSDEP_KEYS.get(name, name) for name in used} | beside
    by_tests = imported('test')
    with_key = {ROSDEP_KEYS[name] for name in by_tests if name in ROSDEP_KEYS}
    assert depends('test_depend') == (with_key | {'python3-pytest-timeout'}) - ours
    assert {name for name in by_tests if name.endswith(ROS_SUFFIXES)} <= ours


def test_catkin_can_read_manifest_and_changelog_and_raise_the_version() -> None:
    package = pytest.importorskip('catkin_pkg.package')
    warnings: list[str] = []
    manifest = package.parse_package(str(SOURCE / 'package.xml'), warnings=warnings)
    manifest.validate(warnings=warnings)
    assert not warnings
    assert manifest.version == tdm_planner.__version__
    changelog = pytest.importorskip('catkin_pkg.changelog')
    package_version = pytest.importorskip('catkin_pkg.package_version')
    made = changelog.Changelog('tdm_planner')
    read = changelog.populate_changelog_from_rst(made, CHANGELOG)
    sections = {str(version): content for version, _, content in read.foreach_version()}
    assert tdm_planner.__version__ in sections
    assert all(len(content) for content in sections.values())
    newest = re.findall(r'^(.+)\n-+$', CHANGELOG, re.MULTILINE)[0]
    assert newest == 'Forthcoming' or newest.startswith(tdm_planner.__version__)
    assert f"version='{tdm_planner.__version__}'," in SETUP
    raised = package_version._replace_setup_py_version(SETUP, '7.8.9')
    assert "version='7.8.9'," in raised


def package_name(requirement: str) -> str:
    name = re.split(r'[\[<>=; ]', requirement)[0]
    return re.sub(r'[-_.]+', '-', name).lower()


def pins(name: str) -> dict[str, str]:
    """Return the versions that a file of constraints pins; of several the first."""
    lines = (SOURCE / name).read_text(encoding='utf-8').splitlines()
    pinned = [line.split(';')[0].split('==') for line in lines if line and line[0] != '#']
    return {package_name(package): version.strip() for package, version in reversed(pinned)}


def test_every_requirement_is_pinned_and_the_oldest_are_those_of_ubuntu():
    """`make test CONSTRAINTS=constraints-noble.txt` runs with the versions that setup.py names."""
    arguments = {n.arg: n.value for n in ast.walk(ast.parse(SETUP)) if isinstance(n, ast.keyword)}
    listed = ast.literal_eval(arguments['install_requires'])
    extras = ast.literal_eval(arguments['extras_require']).values()
    assert sorted(map(package_name, listed)) == sorted(map(package_name, REQUIRED.values()))
    every = {package_name(requirement) for group in (listed, *extras) for requirement in group}
    assert {'numpy', 'ros-jazzy-rclpy', 'ruff'} <= every
    assert every <= set(pins('constraints.txt'))
    oldest = dict(re.findall(r"'([\w-]+)>=([\d.]+)'", SETUP))
    assert {'numpy', 'scipy', 'matplotlib', 'PyYAML', 'rich', 'plotly'} == set(oldest)
    noble = pins('constraints-noble.txt')
    for name in set(oldest) - {'plotly'}:
        assert noble[package_name(name)].startswith(oldest[name]), name


def shell(script: str) -> tuple[str, tuple[str, ...], list[str]]:
    said: list[str] = []
    failure, log = runner._watched(['sh', '-c', script], 600.0, said.append)
    return failure, log, said


@pytest.mark.parametrize(
    ('code', 'says'),
    [
        ('', ''),
        ('echo "ValueError: a wrong number"; echo; exit 1', 'ValueError: a wrong number'),
        ('kill -ABRT $$', 'it was ended by SIGABRT'),
    ],
)
def test_how_a_section_ended(code: str, says: str) -> None:
    failure, log, said = shell(f'echo "{MARK}at work"; echo something else; {code}')
    assert (failure, said) == (says, ['at work'])
    assert 'something else' in log


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = runner.Outcome({}, 'today', 1.0, None, 'it broke', ('a line of its log',))
    monkeypatch.setattr(command, 'run', lambda *_: broken)
    assert command.main(['--quick', '--output', str(tmp_path)]) == 1
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.count('**failed** - it broke') == len(SECTIONS)


def test_the_page_is_that_of_the_figures(tmp_path: Path) -> None:
    """Written anew from the figures beside it, it is the same."""
    pytest.importorskip('casadi')
    shutil.copytree(page.DOCS / 'images', tmp_path / 'images')
    page.write(records_of_runs.read(page.DOCS), tmp_path)
    for name in ('benchmarks.md', 'images/benchmark_success.png'):
        assert (tmp_path / name).stat().st_size > 1000
    written = (tmp_path / 'benchmarks.md').read_text()
    assert written == (page.DOCS / 'benchmarks.md').read_text()

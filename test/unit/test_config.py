# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a release is checked for: generated files, manifest, changelog, versions, benchmark."""

import ast
import os
from pathlib import Path
import re
import sys
from xml.etree import ElementTree

import pytest
from ros_harness import Ros, SOURCE
import tdm_planner
from tdm_planner.cli import EXTRAS
from tdm_planner.parameter_files import ros_parameters
from tdm_planner.starting import REQUIRED
import yaml

FILES = sorted((SOURCE / 'config').glob('*.yaml'), key=lambda path: path.name)


def test_generated_anew_nothing_differs(ros: Ros):
    """Parameter files, the description, the policy, the tables of the pages: `make config`."""
    generate = pytest.importorskip('tools.generate')
    before = dict(os.environ)
    wanted = generate.generated()
    assert dict(os.environ) == before  # or nodes of later tests would not find each other
    assert {path: path.read_text(encoding='utf-8') for path in wanted} == wanted


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_nodes_agree_on_what_stands_twice(path: Path):
    """Parameter files cannot share values, of plant and limits neither: ROS knows no anchors."""
    text = path.read_text(encoding='utf-8')
    document = yaml.safe_load(text)
    names = [str(key).rsplit('/', 1)[-1] for key in document]
    nodes = {name: ros_parameters(document, name) for name in names}
    for name, value in nodes['planner'].items():
        if name.startswith(('plant.', 'limits.')):
            assert all(other.get(name, value) == value for other in nodes.values()), name
    for token in yaml.scan(text):
        assert not isinstance(token, yaml.AliasToken | yaml.AnchorToken | yaml.TagToken)


# What a package that is imported is called by rosdep, where not simply its name.
OF_UBUNTU = 'hypothesis', 'matplotlib', 'numpy', 'pytest', 'rich', 'scipy', 'yaml'
ROSDEP_KEYS = {name: f'python3-{name}' for name in OF_UBUNTU}
# Not in Ubuntu's archive: `make setup` installs them.
WITHOUT_KEY = {*REQUIRED, *EXTRAS, 'trimesh'} - {*ROSDEP_KEYS}
ROS_SUFFIXES = ('_msgs', '_srvs', '_interfaces')
OURS = {'tdm_planner', 'tdm_sim', 'tools', 'benchmark', 'test', 'docs'}
SETUP = (SOURCE / 'setup.py').read_text(encoding='utf-8')
CHANGELOG = (SOURCE / 'CHANGELOG.rst').read_text(encoding='utf-8')


def imported(*folders: str) -> set[str]:
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
    # For `make setup`; what launch files start; what the services of lifecycle nodes are of.
    beside = {'python3-venv', 'robot_state_publisher', 'lifecycle_msgs'}
    assert ours == {ROSDEP_KEYS.get(name, name) for name in used} | beside
    by_tests = imported('test')
    with_key = {ROSDEP_KEYS[name] for name in by_tests if name in ROSDEP_KEYS}
    assert depends('test_depend') == with_key - ours
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
    return re.sub(r'[-_.]+', '-', re.split(r'[\[<>=; ]', requirement)[0]).lower()


def pins(name: str) -> dict[str, str]:
    """Return the versions that a file of constraints pins; of several the first."""
    text = (SOURCE / name).read_text(encoding='utf-8')
    pinned = re.findall(r'^([^#=;\n]+)==([^;\n]+)', text, re.MULTILINE)
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

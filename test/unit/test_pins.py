# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What is asked for when the package is installed: pinned, and as old as promised."""

from __future__ import annotations

import ast
import re

from ros_harness import SOURCE
import tdm_planner


def requirements() -> set[str]:
    """Everything that setup.py asks for, extras included, as package names."""
    tree = ast.parse((SOURCE / 'setup.py').read_text(encoding='utf-8'))
    given = {node.arg: node.value for node in ast.walk(tree) if isinstance(node, ast.keyword)}
    listed = ast.literal_eval(given['install_requires'])
    groups = [listed, *ast.literal_eval(given['extras_require']).values()]
    return {package_name(requirement) for group in groups for requirement in group}


def package_name(requirement: str) -> str:
    name = re.split(r'[\[<>=; ]', requirement)[0]
    return re.sub(r'[-_.]+', '-', name).lower()


def test_every_requirement_is_pinned():
    assert {'numpy', 'ros-jazzy-rclpy', 'ruff'} <= requirements()
    assert requirements() <= set(pins('constraints.txt'))


def test_oldest_versions_promised_are_those_of_ubuntu():
    """`make test CONSTRAINTS=constraints-noble.txt` runs with the versions that setup.py names."""
    text = (SOURCE / 'setup.py').read_text(encoding='utf-8')
    oldest = dict(re.findall(r"'([\w-]+)>=([\d.]+)'", text))
    noble = pins('constraints-noble.txt')
    assert {'numpy', 'scipy', 'matplotlib', 'PyYAML', 'rich'} == set(oldest) - {'plotly'}
    for name in set(oldest) - {'plotly'}:
        assert noble[package_name(name)].startswith(oldest[name]), name


def pins(name: str) -> dict[str, str]:
    """Return the versions that a file of constraints pins; of several the first."""
    found: dict[str, str] = {}
    for line in (SOURCE / name).read_text(encoding='utf-8').splitlines():
        if line and not line.startswith('#'):
            package, version = line.split(';')[0].split('==')
            found.setdefault(package_name(package), version.strip())
    return found


def test_changelog_tells_of_the_version_or_of_what_is_coming():
    text = (SOURCE / 'CHANGELOG.rst').read_text(encoding='utf-8')
    heading = re.findall(r'^(.+)\n-+$', text, re.MULTILINE)[0]
    assert heading == 'Forthcoming' or heading.startswith(tdm_planner.__version__)

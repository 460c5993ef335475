# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What a maintainer looks at before a release: manifest, changelog, version."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
import re
import sys
from typing import Any
from xml.etree import ElementTree

import pytest
import tdm_planner
from tdm_planner.starting import REQUIRED
from tools.headers import FOLDERS, sources
import yaml

SOURCE = Path(__file__).resolve().parents[2]
SOURCES = [path for path in sources() if path.suffix == '.py' and path.name != 'setup.py']
# Order and number of elements in package_format3.xsd (REP 149).
ELEMENTS = ['name', 'version', 'description', 'maintainer', 'license', 'url', 'author']
DEPENDENCIES = re.compile(r'(build|build_export|buildtool|buildtool_export|exec|doc|test)_depend$')
# What a package that is imported is called by rosdep, where not simply its name.
ROSDEP_KEYS = {
    'hypothesis': 'python3-hypothesis',
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'pytest': 'python3-pytest',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'yaml': 'python3-yaml',
}
WITHOUT_KEY = {*REQUIRED} - {*ROSDEP_KEYS}  # not in Ubuntu's archive: `make setup` installs them
ROS_SUFFIXES = ('_msgs', '_srvs', '_interfaces')
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
# Whatever the tests import by the name of a file beside them, or of a folder of sources.
BESIDE = {path.stem: path for path in (SOURCE / 'test').rglob('*.py')}


def imported(*folders: str) -> set[str]:
    """Top-level packages that the sources in these folders import, anywhere."""
    found: set[str] = set()
    for path in SOURCES:
        if path.relative_to(SOURCE).parts[0] not in folders:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).split('.')[0])
    return found - set(sys.stdlib_module_names) - {*FOLDERS} | found & {'launch'}


@cache
def at_import(path: Path) -> list[ast.stmt | ast.Call]:
    """Return imports and calls that are carried out when a file is imported, in their order."""

    def inside(node: ast.AST) -> Iterator[ast.stmt | ast.Call]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import | ast.ImportFrom | ast.Call):
                yield child
            optional = isinstance(child, ast.Try) and 'ImportError' in ast.dump(child)
            if not optional and not isinstance(child, FUNCTIONS):
                yield from inside(child)

    return list(inside(ast.parse(path.read_text(encoding='utf-8'))))


def asked_for(call: ast.Call) -> str | None:
    """Return the package that is looked for before it is imported."""
    name = getattr(call.func, 'attr', getattr(call.func, 'id', ''))
    if name in ('importorskip', 'find_spec') and isinstance(call.args[0], ast.Constant):
        return str(call.args[0].value).split('.')[0]
    return None


def modules_of(node: ast.stmt) -> list[str]:
    """Return the modules that a statement may import: a name may be a module's."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    assert isinstance(node, ast.ImportFrom)
    assert not node.level
    return [str(node.module), *(f'{node.module}.{alias.name}' for alias in node.names)]


@cache
def files_of(module: str) -> list[Path]:
    """Return the sources that an import of a module of ours reads, and no file of others."""
    parts = module.split('.')
    if parts[0] not in FOLDERS:
        return []
    paths = [SOURCE.joinpath(*parts[: k + 1]) for k in range(len(parts))]
    candidates = [file for path in paths for file in (path / '__init__.py', Path(f'{path}.py'))]
    return [file for file in candidates if file.is_file()]


def needed(test: Path) -> dict[str, str]:
    """Return the packages without which a test cannot be imported, and where they are imported."""
    found: dict[str, str] = {}
    asked = set(sys.stdlib_module_names)
    seen: set[Path] = set()

    def run(path: Path) -> None:
        if path in seen:
            return
        seen.add(path)
        for node in at_import(path):
            if isinstance(node, ast.Call):
                asked.add(str(asked_for(node)))
                continue
            for module in modules_of(node):
                name = module.split('.')[0]
                for file in [BESIDE[name]] if name in BESIDE else files_of(module):
                    run(file)
                if name not in {*FOLDERS, *BESIDE, *asked}:
                    found.setdefault(name, f'{path.relative_to(SOURCE)}:{node.lineno}')

    conftest = SOURCE / 'test' / 'conftest.py'
    if conftest.is_file():
        run(conftest)
    run(test)
    return found


@pytest.fixture(scope='module')
def manifest() -> ElementTree.Element:
    return ElementTree.parse(SOURCE / 'package.xml').getroot()


def depends(manifest: ElementTree.Element, kind: str) -> set[str]:
    found = [str(element.text) for element in manifest.findall(kind)]
    assert len(found) == len(set(found)), found
    return set(found)


def test_manifest_is_read_without_a_warning() -> None:
    package = pytest.importorskip('catkin_pkg.package')
    warnings: list[str] = []
    read = package.parse_package(str(SOURCE / 'package.xml'), warnings=warnings)
    read.validate(warnings=warnings)
    assert not warnings
    assert read.version == tdm_planner.__version__


def test_manifest_keeps_to_its_schema(manifest: ElementTree.Element):
    names = [element.tag for element in manifest]
    head = [name for name in names if name in ELEMENTS]
    count = len(head)
    assert names[:count] == head == sorted(head, key=ELEMENTS.index)
    rest = names[count:]
    assert rest[-1] == 'export'
    assert all(DEPENDENCIES.match(name) for name in rest[:-1])
    assert re.fullmatch(r'[a-z](_?[a-z0-9]+)*', str(manifest.findtext('name')))
    assert re.fullmatch(r'(0|[1-9]\d*)(\.(0|[1-9]\d*)){2}', str(manifest.findtext('version')))


def test_manifest_depends_on_what_is_used_and_nothing_else(manifest: ElementTree.Element):
    """Neither RViz nor rosbag2 is listed: a rig without a screen is to get no window system."""
    used = imported('tdm_planner', 'tdm_sim', 'launch') - WITHOUT_KEY
    wanted = {ROSDEP_KEYS.get(name, name) for name in used}
    beside = {'python3-venv', 'robot_state_publisher'}  # for `make setup`; what launch files start
    assert depends(manifest, 'exec_depend') == wanted | beside


def test_tests_depend_on_what_they_use(manifest: ElementTree.Element):
    tested = depends(manifest, 'test_depend')
    with_key = {ROSDEP_KEYS[name] for name in imported('test') if name in ROSDEP_KEYS}
    ours = depends(manifest, 'exec_depend')
    assert tested == (with_key | {'python3-pytest-timeout'}) - ours
    ros = {name for name in imported('test') if name.endswith(ROS_SUFFIXES)}
    assert ros <= ours


def test_with_what_rosdep_installs_all_tests_are_collected(manifest: ElementTree.Element):
    """Whatever else a test needs it must ask for: pytest.importorskip, or within a function."""
    listed = depends(manifest, 'exec_depend') | depends(manifest, 'test_depend')
    missing = {}
    for path in SOURCES:
        if path.relative_to(SOURCE).parts[0] == 'test' and path.name.startswith(('test_', 'conf')):
            packages = needed(path).items()
            keys = {by: ROSDEP_KEYS.get(name, name) for name, by in packages}
            found = {by for by, key in keys.items() if key not in listed | WITHOUT_KEY}
            if found:
                missing[path.name] = sorted(found)
    assert not missing


def test_what_a_test_asks_for_is_told_from_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    helper, test = tmp_path / 'test' / 'this_helper.py', tmp_path / 'test' / 'test_this.py'
    helper.parent.mkdir()
    monkeypatch.setattr(sys.modules[__name__], 'SOURCE', tmp_path)
    monkeypatch.setitem(BESIDE, 'this_helper', helper)
    helper.write_text('import one, two.three\ndef later():\n    import four\n')
    test.write_text('if True:\n    from this_helper import x\nimport os\nfrom five import y\n')
    assert needed(test) == {
        'one': 'test/this_helper.py:1',
        'two': 'test/this_helper.py:1',
        'five': 'test/test_this.py:4',
    }
    at_import.cache_clear()
    test.write_text(
        "import pytest\npytest.importorskip('two.three')\nimport this_helper\n"
        "if find_spec('five'):\n    import five\npytest.importorskip('one')\n"
        'try:\n    import six\nexcept ImportError:\n    six = None\n'
    )
    assert set(needed(test)) == {'pytest', 'one'}
    at_import.cache_clear()


def test_catkin_can_read_the_changelog_and_raise_the_version():
    changelog = pytest.importorskip('catkin_pkg.changelog')
    package_version = pytest.importorskip('catkin_pkg.package_version')
    text = (SOURCE / 'CHANGELOG.rst').read_text(encoding='utf-8')
    made = changelog.Changelog('tdm_planner')
    read = changelog.populate_changelog_from_rst(made, text)
    sections = {str(version): content for version, _, content in read.foreach_version()}
    assert tdm_planner.__version__ in sections
    assert all(len(content) for content in sections.values())
    setup = (SOURCE / 'setup.py').read_text(encoding='utf-8')
    assert f"version='{tdm_planner.__version__}'," in setup
    raised = package_version._replace_setup_py_version(setup, '7.8.9')
    assert "version='7.8.9'," in raised
    assert load('CITATION.cff')['version'] == tdm_planner.__version__


def load(name: str) -> Any:
    return yaml.safe_load((SOURCE / name).read_text(encoding='utf-8'))

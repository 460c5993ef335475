# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Nothing in the package runs, unpickles or formats into a shell what it was given."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[3]
FILES = sorted(
    path
    for folder in ('tdm_planner', 'tdm_sim', 'launch')
    for path in (SOURCE / folder).rglob('*.py')
)
MODULES = {'pickle', 'cPickle', 'dill', 'shelve', 'marshal', 'joblib', 'cloudpickle', 'telnetlib'}
CALLS = {
    'eval',
    'exec',
    '__import__',
    'os.system',
    'os.popen',
    'pandas.read_pickle',
    'subprocess.getoutput',
    'tempfile.mktemp',
    'yaml.full_load',
    'yaml.unsafe_load',
}


def dotted(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return f'{dotted(node.value)}.{node.attr}'
    return node.id if isinstance(node, ast.Name) else ''


def offences(tree: ast.AST) -> list[str]:
    """Return what is not to be in a source file, by line."""
    found = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name.split('.')[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [str(node.module).split('.')[0]]
        found += [f'{node.lineno}: {name}' for name in names if name in MODULES]
        if not isinstance(node, ast.Call):
            continue
        call = dotted(node.func)
        keywords = {item.arg: item.value for item in node.keywords}
        if call in CALLS:
            found.append(f'{node.lineno}: {call}')
        shell = keywords.get('shell')
        if shell is not None and not (isinstance(shell, ast.Constant) and shell.value is False):
            found.append(f'{node.lineno}: shell')
        if 'allow_pickle' in keywords:
            found.append(f'{node.lineno}: allow_pickle')
        if call == 'yaml.load' and dotted(keywords.get('Loader', node)) not in (
            'yaml.SafeLoader', 'yaml.CSafeLoader', '_Loader',
        ):  # fmt: skip
            found.append(f'{node.lineno}: yaml.load')
    return found


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_a_source_file_does_nothing_unsafe(path: Path) -> None:
    assert not offences(ast.parse(path.read_text(encoding='utf-8')))


@pytest.mark.parametrize(
    'line',
    ['import pickle', 'from dill import load', 'eval(x)', 'exec(x)', 'os.system(x)',
     'subprocess.run(x, shell=True)', 'np.load(x, allow_pickle=True)', 'yaml.load(x)',
     'yaml.load(x, Loader=yaml.Loader)', 'yaml.unsafe_load(x)'],
)  # fmt: skip
def test_what_is_unsafe_is_seen(line: str) -> None:
    assert len(offences(ast.parse(line))) == 1


def test_the_loader_of_parameter_files_is_a_safe_one() -> None:
    from tdm_planner.parameter_files import _Loader
    import yaml

    assert issubclass(_Loader, yaml.SafeLoader)
    assert not any('python' in str(tag) for tag in _Loader.yaml_constructors)

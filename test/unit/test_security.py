# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Security by reading: no source runs what it was given, the policy is well-formed."""

from __future__ import annotations

import ast
import re
from xml.etree import ElementTree

import pytest
from ros_harness import SOURCE

POLICY = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml').getroot()
# Elements, their attributes (a * may be left out) and children, as sros2's policy.xsd has them.
SCHEMA: dict[str, tuple[set[str], set[str]]] = {
    'policy': ({'version'}, {'contexts'}),
    'contexts': (set(), {'context'}),
    'context': ({'path'}, {'profiles'}),
    'profiles': ({'type*'}, {'profile', 'metadata'}),
    'profile': ({'ns', 'node'}, {'topics', 'services', 'actions'}),
    'topics': ({'publish*', 'subscribe*'}, {'topic'}),
    'services': ({'reply*', 'request*'}, {'service'}),
    'topic': (set(), set()),
    'service': (set(), set()),
}
FILES = sorted(
    path
    for folder in ('tdm_planner', 'tdm_sim', 'launch')
    for path in (SOURCE / folder).rglob('*.py')
)
MODULES = {'pickle', 'cPickle', 'dill', 'shelve', 'marshal', 'joblib', 'cloudpickle', 'telnetlib'}
CALLS = {'eval', 'exec', '__import__', 'os.system', 'os.popen', 'pandas.read_pickle',
         'subprocess.getoutput', 'tempfile.mktemp', 'yaml.full_load',
         'yaml.unsafe_load'}  # fmt: skip


def dotted(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return f'{dotted(node.value)}.{node.attr}'
    return node.id if isinstance(node, ast.Name) else ''


def offences(tree: ast.AST) -> list[str]:
    """Return what is not to be in a source file, by line."""
    found = []
    for node in ast.walk(tree):
        words: list[str] = []
        if isinstance(node, ast.Import):
            words = [alias.name.split('.')[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            words = [str(node.module).split('.')[0]]
        words = [word for word in words if word in MODULES]
        if isinstance(node, ast.Call):
            call = dotted(node.func)
            keywords = {item.arg: item.value for item in node.keywords}
            words += [call] if call in CALLS else []
            words += [name for name in ('shell', 'allow_pickle') if name in keywords]
            if call == 'yaml.load' and dotted(keywords.get('Loader', node)) != '_Loader':
                words.append(call)
        found += [f'{node.lineno}: {word}' for word in words]
    return found


def test_no_source_file_does_anything_unsafe() -> None:
    found = {path: offences(ast.parse(path.read_text(encoding='utf-8'))) for path in FILES}
    # What CasADi wrote of a function in the package is run.
    (written,) = found.pop(SOURCE / 'tdm_planner/plants/slopes.py')
    assert written.endswith(': exec')
    assert not {path: lines for path, lines in found.items() if lines}


@pytest.mark.parametrize(
    'line',
    ['import pickle', 'from dill import load', 'eval(x)', 'exec(x)', 'os.system(x)',
     'subprocess.run(x, shell=True)', 'np.load(x, allow_pickle=True)', 'yaml.load(x)',
     'yaml.load(x, Loader=yaml.Loader)', 'yaml.unsafe_load(x)'],
)  # fmt: skip
def test_what_is_unsafe_is_seen(line: str) -> None:
    assert len(offences(ast.parse(line))) == 1


def test_the_policy_follows_the_schema() -> None:
    assert (POLICY.tag, POLICY.get('version')) == ('policy', '0.2.0')
    for element in POLICY.iter():
        attributes, children = SCHEMA[element.tag]
        given = set(element.attrib)
        assert {name for name in attributes if not name.endswith('*')} <= given
        assert given <= {name.rstrip('*') for name in attributes}
        assert {child.tag for child in element} <= children
        assert len(element) or not children
        if element.tag in ('topics', 'services'):
            assert set(element.attrib.values()) == {'ALLOW'}
        if element.tag in ('topic', 'service'):
            assert re.fullmatch(r'(/[A-Za-z_][A-Za-z0-9_]*)+', element.text or '')
    contexts = POLICY.findall('contexts/context')
    assert len({context.get('path') for context in contexts}) == len(contexts)
    for context in contexts:  # every enclave is that of its node
        (profile,) = context.findall('profiles/profile')
        name = f'{profile.attrib["ns"].rstrip("/")}/{profile.attrib["node"]}'
        assert name == context.attrib['path']

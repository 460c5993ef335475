# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameter files and settings with anything in them: parameters, or one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fuzz_corpus import corpus
from fuzz_judges import outcome
from fuzz_profiles import cases
from fuzz_strategies import yaml_texts
from hypothesis import given
from hypothesis import strategies as st
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import read_parameters
from tdm_planner.problems import PendulumSwingUp


def read(path: Path, text: str) -> Any:
    """Read a file of this text and make a problem of what is in it."""
    path.write_bytes(text.encode('utf-8', 'surrogatepass'))
    return outcome(lambda: PendulumSwingUp.from_parameters(read_parameters(path)), text)


@pytest.fixture(scope='module')
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('fuzz') / 'parameters.yaml'


@cases(70)
@given(text=yaml_texts())
def test_a_file_is_read_or_refused(path: Path, text: str) -> None:
    assert isinstance(read(path, text), (PendulumSwingUp, InvalidProblem))


@cases(30)
@given(st.binary(max_size=60))
def test_bytes_are_read_or_refused(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    found = outcome(lambda: read_parameters(path), repr(data))
    assert isinstance(found, (dict, InvalidProblem))


@cases(30)
@given(yaml_texts())
def test_a_setting_is_read_or_refused(text: str) -> None:
    found = outcome(lambda: read_parameters(None, [text, f'start.psi={text}']), text)
    assert isinstance(found, (dict, InvalidProblem))


@pytest.mark.parametrize('text', corpus('yaml'))
def test_what_once_escaped_does_so_no_more(path: Path, text: str) -> None:
    assert isinstance(read(path, text), InvalidProblem)
    assert isinstance(outcome(lambda: read_parameters(None, [f'a={text}']), text), InvalidProblem)


BOMB = 'a0: &a0 {x: 1, y: 2}\n' + ''.join(
    f'a{k}: &a{k} {{x: *a{k - 1}, y: *a{k - 1}}}\n' for k in range(1, 60)
)


@pytest.mark.parametrize('text', [BOMB, 'a: &a [*a]', 'a: &a {b: *a}', '[' * 100_000])
def test_a_document_without_end_is_refused(path: Path, text: str) -> None:
    path.write_text(text)
    with pytest.raises(InvalidProblem, match=r'parameters.yaml.* is not YAML'):
        read_parameters(path)


@pytest.mark.parametrize(
    'tag',
    [
        '!!python/object/apply:os.system ["touch owned"]',
        '!!python/object/new:subprocess.Popen [["touch", "owned"]]',
        '!!python/name:os.system',
        '!!python/module:os',
        '!!python/tuple [1, 2]',
        '!ruby/object:Gem {}',
    ],
)
def test_objects_of_a_language_are_refused_in_one_sentence(
    path: Path, tag: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(path.parent)
    path.write_text(f'planner:\n  ros__parameters:\n    robots: {tag}\n')
    with pytest.raises(InvalidProblem, match='could not determine a constructor') as refusal:
        read_parameters(path)
    assert '\n' not in str(refusal.value)
    assert [item.name for item in path.parent.iterdir()] == [path.name]

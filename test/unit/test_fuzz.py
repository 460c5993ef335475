# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Bad input, sabotaged solvers: some of every kind, and every case that ever escaped."""

import re

from fuzzing import corpus, planned, PROPERTIES, read_file, read_setting, survived, try_out
import pytest
from saboteurs import replayed_faults
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import _Loader
from tdm_planner.problems import PendulumSwingUp


@pytest.mark.parametrize('name', PROPERTIES)
def test_bad_input_is_met_with_a_result_or_a_reason(name: str) -> None:
    try_out(name)


CORPUS = corpus('parameters') + corpus('trackers') + corpus('yaml')


@pytest.mark.parametrize('case', CORPUS)
def test_parameters_histories_and_files_that_once_escaped_do_so_no_more(case: dict | str) -> None:
    if isinstance(case, str):
        assert isinstance(read_file(case), InvalidProblem)
        assert isinstance(read_setting(case), InvalidProblem)
    elif 'problem' in case:
        planned(case['problem'], case['parameters'])
    else:
        pytest.importorskip('rclpy')
        survived(case)


@pytest.mark.parametrize('name', ['deadline', 'seed'])
@pytest.mark.parametrize('value', [float('nan'), float('inf'), -1, -(10**400), 'soon', True, [1]])
def test_arguments_of_a_search_are_refused_by_name(name: str, value) -> None:
    with pytest.raises(InvalidProblem, match=name):
        PendulumSwingUp().solve(**{name: value})


DOUBLED = (f'a{k}: &a{k} {{x: *a{k - 1}, y: *a{k - 1}}}\n' for k in range(1, 60))
BOMB = 'a0: &a0 {x: 1, y: 2}\n' + ''.join(DOUBLED)


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        *((text, r'parameters.yaml.* is not YAML') for text in (BOMB, 'a: &a [*a]', '[' * 5_000)),
        ('planner: {ros__parameters: {a: 1, b: 2, a: 1}}', "'a' is given twice, again in line 1"),
        ('/**:\n  a: {ros__parameters: {}}\n/**:\n  b: {}', r"'/\*\*' is given .* in line 3"),
        *(
            (f'planner: {{ros__parameters: {{robots: {tag} }} }}', 'not determine a constructor')
            for tag in ('!!python/object/apply:os.system ["touch owned"]',
                        '!!python/object/new:subprocess.Popen [["touch", "owned"]]',
                        '!!python/name:os.system', '!!python/tuple [1, 2]', '!ruby/object:Gem {}')
        ),
    ],
)  # fmt: skip
def test_endless_documents_and_foreign_objects_are_refused(tmp_path, text, says, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusal = read_file(text)
    assert isinstance(refusal, InvalidProblem)
    assert re.search(says, str(refusal))
    assert not list(tmp_path.iterdir())
    assert not any('python' in str(tag) for tag in _Loader.yaml_constructors)


@pytest.mark.parametrize(('kind', 'wanted'), [('pendulum', 10), ('robots', 6)])
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind: str, wanted: int) -> None:
    assert not replayed_faults(kind, 2006, wanted)

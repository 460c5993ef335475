# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What the README tells people to type and to open is there."""

from __future__ import annotations

import os
from pathlib import Path
import re
import shlex
import subprocess
import sys

import pytest

SOURCE = Path(__file__).resolve().parents[1]
README = (SOURCE / 'README.md').read_text(encoding='utf-8')


def blocks(language: str) -> list[str]:
    return re.findall(rf'^```{language}\n(.*?)^```$', README, re.DOTALL | re.MULTILINE)


def shell_lines(*first_words: str) -> list[list[str]]:
    lines = [
        shlex.split(line, comments=True) for block in blocks('sh') for line in block.splitlines()
    ]
    return [words for words in lines if words[: len(first_words)] == list(first_words)]


def test_python_examples_run(capsys: pytest.CaptureFixture[str]):
    assert blocks('python')
    for block in blocks('python'):
        exec(compile(block, 'README.md', 'exec'), {})
    assert 'True' in capsys.readouterr().out


def test_plan_commands_write_what_they_say(tmp_path: Path):
    commands = shell_lines('tdm', 'plan')
    assert commands
    for _, *arguments in commands:
        command = [sys.executable, '-m', 'tdm_planner.cli', *arguments]
        subprocess.run(
            command,
            cwd=tmp_path,
            check=True,
            timeout=120,
            capture_output=True,
            env={**os.environ, 'PYTHONPATH': str(SOURCE)},
        )
        for option in ('-o', '--plot'):
            assert (tmp_path / arguments[arguments.index(option) + 1]).stat().st_size > 0


def test_make_targets_exist():
    makefile = (SOURCE / 'Makefile').read_text(encoding='utf-8')
    targets = {words[1] for words in shell_lines('make')} | set(re.findall(r'`make (\w+)', README))
    assert {'demo', 'test'} <= targets
    for target in targets:
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), target


def test_continuous_integration_tests_as_the_readme_says():
    script = (SOURCE / '.ci' / 'run').read_text(encoding='utf-8')
    assert re.search(r'^step .* make test$', script, re.MULTILINE)


def test_launch_commands_name_launch_files():
    commands = shell_lines('ros2', 'launch')
    assert commands
    for _, _, package, file, *_ in commands:
        assert package == 'tdm_planner'
        assert (SOURCE / 'launch' / file).is_file()


def test_links_lead_somewhere():
    links = re.findall(r'\]\((?!https?:)([^)#]+)\)', README)
    assert 'CONTRIBUTING.md' in links
    assert not [link for link in links if not (SOURCE / link).exists()]

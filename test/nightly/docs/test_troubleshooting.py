# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every message that the troubleshooting page quotes is one that the code can say."""

from __future__ import annotations

import ast
import re

from ros_harness import SOURCE

HOLE = '\0'  # stands for what is filled in at run time


def text_of(node: ast.AST) -> str | None:
    """Return a string expression with holes for what is filled in; None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return ''.join(text_of(part) or HOLE for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [text_of(node.left), text_of(node.right)]
        return None if parts == [None, None] else ''.join(part or HOLE for part in parts)
    return HOLE if isinstance(node, ast.IfExp) else None


def test_quoted_messages_are_in_the_code():
    said = [' '.join((SOURCE / 'Makefile').read_text(encoding='utf-8').split())]
    for package in ('tdm_planner', 'tdm_sim'):
        for path in (SOURCE / package).rglob('*.py'):
            tree = ast.parse(path.read_text(encoding='utf-8'))
            said += [text for node in ast.walk(tree) if (text := text_of(node)) is not None]

    def can_be_said(quoted: str) -> bool:
        """Whether some string of the code holds the quoted one, dots standing for anything."""
        parts = [re.escape(part) for part in quoted.split('...')]
        inside = re.compile('.*?'.join(parts).removeprefix('.*?').removesuffix('.*?'), re.DOTALL)
        return any(inside.search(text) for text in said)

    page = (SOURCE / 'docs' / 'troubleshooting.md').read_text(encoding='utf-8')
    quoted = re.findall(r'^> `(.+)`$', page, re.MULTILINE)
    assert quoted
    assert not [text for text in quoted if not can_be_said(text)]
    assert not can_be_said('the pendulum ... fell off')

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every case that ever escaped, as JSON: [{"was": what happened, "case": ...}, ...] a kind."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parent / 'corpus'


def corpus(kind: str) -> list[Any]:
    """Return the cases of a kind as parameters of a test, named for what they once did."""
    entries = json.loads((FOLDER / f'{kind}.json').read_text(encoding='utf-8'))
    return [
        pytest.param(entry['case'], id=f'{number}: {entry["was"]}')
        for number, entry in enumerate(entries)
    ]

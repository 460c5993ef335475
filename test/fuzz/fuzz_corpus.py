# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
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

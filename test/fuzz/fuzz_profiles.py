# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""How many cases: 500 in CI, always the same; over 10,000 with TDM_FUZZ=nightly."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, Phase, settings

NIGHTLY = os.environ.get('TDM_FUZZ') == 'nightly'
_FACTOR = 22 if NIGHTLY else 1


def cases(few: int) -> settings:
    """Return the settings of a test that makes `few` cases in continuous integration."""
    return settings(
        max_examples=few * _FACTOR,
        deadline=None,
        derandomize=not NIGHTLY,
        database=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
        # What is found is kept in the corpus; making it smaller takes long where cases are slow.
        phases=[Phase.explicit, Phase.generate]
        if NIGHTLY
        else [Phase.explicit, Phase.generate, Phase.shrink],
    )

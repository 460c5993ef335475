# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A tracker whose first activation and first deactivation break down, half-way."""

from __future__ import annotations

import sys

from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.tracker import TrackerNode


class FragileTracker(TrackerNode):
    activations = deactivations = 0

    def activate(self) -> None:
        super().activate()
        self.activations += 1
        if self.activations == 1:
            raise RuntimeError('something\nbroke')

    def deactivate(self) -> None:
        self.deactivations += 1
        if self.deactivations == 2:  # the first is that of the broken activation
            raise RuntimeError('something else broke')
        super().deactivate()


if __name__ == '__main__':
    sys.exit(run(FragileTracker))

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A tracker whose first activation and first deactivation break down, half-way."""

from __future__ import annotations

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

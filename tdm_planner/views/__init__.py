# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Descriptions for viewers: RViz configurations, Foxglove layouts, the pendulum's URDF; no ROS."""

from __future__ import annotations


def absolute(*parts: str) -> str:
    """Return ``/a/b`` for the parts a and b of a name; empty parts are skipped."""
    return '/' + '/'.join(part.strip('/') for part in parts if part.strip('/'))

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Descriptions for viewers: RViz configurations, Foxglove layouts, the pendulum's URDF; no ROS."""

from __future__ import annotations


def absolute(*parts: str) -> str:
    """Return ``/a/b`` for the parts a and b of a name; empty parts are skipped."""
    return '/' + '/'.join(part.strip('/') for part in parts if part.strip('/'))

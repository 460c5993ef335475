# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Near-optimal trajectories in real time by Taranenko's direct method."""

__version__ = '0.1.0'

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the frames that poses and markers are given in."""

WORLD_FRAME = 'world'  # of the pendulum: the disk's centre, z up, psi about z from x
ARENA_FRAME = 'arena'  # of the robots: a corner, x along the length, y along the width

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Formations of robots: polynomials of the virtual arc, or thrust arcs."""

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Colours of plots and reports, told apart by people with any colour vision."""

# After Okabe and Ito, darkened where they are pale on white.
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#c05d94', '#9a7400', '#6f6fc8', '#5c7f8a', '#a0522d')
PLANNED, MEASURED = COLOURS[:2]
LIMIT = '#c43d3d'
SWITCH = '#8a8f98'

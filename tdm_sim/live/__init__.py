# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The page `tdm live`: planner, trackers and plants shown in the browser, and moved by hand.

`listener` and `rig` know the nodes, `geometry` and `scene` draw, `panel` is what stands beside it,
`operations` is what is done by hand; `page` brings them together.
"""

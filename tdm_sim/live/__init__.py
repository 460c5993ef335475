# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The page `tdm live`: planner, trackers and plants shown in the browser, and moved by hand.

`geometry`, `drag_handles`, `sliders`, `history` and `task_thread` know neither ROS nor the page.
`listener` knows the nodes, `scene` and `panel` know the page, `page` brings them together.
"""

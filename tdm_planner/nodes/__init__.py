# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 nodes: the planner and the tracker, and what every node of the package is built on."""

from tdm_planner.starting import require_one_ros

require_one_ros()

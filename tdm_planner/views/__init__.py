# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Descriptions for viewers: RViz configurations, Foxglove layouts, the pendulum's URDF; no ROS."""

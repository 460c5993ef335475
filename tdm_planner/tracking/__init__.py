# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Feedback laws that keep a plant on its plan and hold it at the goal; no ROS."""

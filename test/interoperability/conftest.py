# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""These tests need Cyclone DDS, whose wheels are for Python 3.10 to 3.13."""

import importlib.util

if importlib.util.find_spec('cyclonedds') is None:
    collect_ignore_glob = ['test_*.py']

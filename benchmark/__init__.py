# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Measurements of the package: `python -m benchmark`."""

from tdm_planner.starting import limit_threads

limit_threads()

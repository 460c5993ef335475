# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Programs for who works on the package: `python -m tools.<name>`."""

from tdm_planner.starting import limit_threads

limit_threads()

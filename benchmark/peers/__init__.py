# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The same problems solved by this package and by what users would reach for otherwise."""

from benchmark.peers.measure import run
from benchmark.peers.tables import table

__all__ = ['run', 'table']

# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Adapters: what the planner node needs to know of each kind of problem."""

from tdm_planner.nodes.adapters.base import Adapter
from tdm_planner.nodes.adapters.selection import adapter_class

__all__ = ['Adapter', 'adapter_class']

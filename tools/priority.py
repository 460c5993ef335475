# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Priority of measured processes on a machine that does other things besides."""

from __future__ import annotations

from collections.abc import Mapping
import os

_CONTROL, _REST = 20, 10  # of SCHED_RR; what must be quick goes before what takes long


def make_real_time(identifiers: Mapping[str, int]) -> None:
    """Give processes just started, by name, and this one, real-time priority; needs root.

    Plants and trackers go before planners, as on a robot's computer.
    """
    for name, identifier in {**identifiers, 'this': os.getpid()}.items():
        level = _CONTROL if 'plant' in name or 'tracker' in name else _REST
        os.sched_setscheduler(identifier, os.SCHED_RR, os.sched_param(level))

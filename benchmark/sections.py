# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The sections of the benchmark: what each measures, how much of it, how long it may take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any

Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """
    A module of the benchmark with `run(**settings)` and `table(figures)`.

    `full` are the settings of the page, `quick` those that only show that everything works;
    `about` says what is measured, with the settings' values in braces. A section that takes
    longer than `limit` s is ended.
    """

    name: str
    title: str
    about: str
    full: Settings
    quick: Settings
    limit: float

    def run(self, **settings: Any) -> dict[str, Any]:
        """Measure; returns figures that JSON can hold."""
        found: dict[str, Any] = import_module(f'benchmark.{self.name}').run(**settings)
        return found

    def table(self, figures: Mapping[str, Any]) -> str:
        """Return figures as lines of text."""
        text: str = import_module(f'benchmark.{self.name}').table(figures)
        return text


_SECTIONS = (
    Section(
        'pendulum',
        'Pendulum',
        'Swing-ups from {states} random states of either torque limit (any angle, +-1 rad of the '
        'disk, rates up to 5 rad/s); times of the motion against the best known of a long search '
        '(`benchmark/pendulum_reference.py`), wall times of solving.',
        {'states': 100},
        {'states': 2},
        300.0,
    ),
    Section(
        'rigs',
        'Rigs',
        'Swing-ups of {rigs} rigs of random constants, default settings, 1 s, by their drive, the '
        "pendulum's acceleration by the torque over that by gravity: com distance .06-2 m, arm "
        '.2-2 times that, .01-10 kg, inertias of pendulum and disk .01-30 m l^2, torque '
        '.05-5 m g l, disk limits .8-4 rad. Replans start half-way, .02 rad and .02 w0 off.',
        {'rigs': 200},
        {'rigs': 3},
        900.0,
    ),
    Section(
        'robots',
        'Robots',
        'Random crossings of robots: {scenarios} of three, up to 50 of other teams, 30 of every '
        'variant of the method; costs against the best of three local solutions of collocation, '
        'which uses all of the thrust (thrust arcs leave a tenth to the feedback), processor '
        'times of solving.',
        {'scenarios': 100, 'teams': True, 'variants': True},
        {'scenarios': 2},
        300.0,
    ),
    Section(
        'closed_loop',
        'Closed loops',
        "The trackers' own code on plants that are not their models, {seeds} seeds each: physical "
        'constants and actuator gains off by up to 5 %, measurements with noise, no plan made '
        'anew. A pendulum is held when |theta| < .05 rad and |psi| < 2 rad throughout the last '
        '5 s; robots have arrived when every one is within 2 cm of its goal from its arrival '
        'on until 5 s after the last.',
        {'seeds': 20},
        {'seeds': 1},
        600.0,
    ),
    Section(
        'replanning',
        'Replanning',
        'The replanner and the trackers of the nodes, reviews at 5 Hz, {seeds} seeds each; plants '
        'off by up to 5 % and noise as above. The pendulum (.02 N m) is pushed half-way by 30 % '
        "of the swing's largest momentum; of three robots one is pushed half-way by .05 m/s in a "
        'random direction, or the formation is moved by up to .5 m along each axis and .5 rad. '
        '*At once*: from the first catch on it is never lost again; *in 10 s*: upright within '
        '.05 rad from 10 s after the start until 15 s after it. Robots have arrived when all '
        "stay within 2 cm of their goals over the last 3 of 5 s after the last plan's end.",
        {'seeds': 40},
        {'seeds': 1},
        900.0,
    ),
    Section(
        'latency',
        'Latency',
        'Replans from states along a plan under way, off by what tracking leaves: {warm_replans} '
        'of each kind from the rest of that plan, {cold_replans} without it, wall times. Then '
        '{replans:,} with a deadline of 30 ms in one process, whose memory is looked at. Last, '
        'planner, tracker and plant as nodes: the pendulum is pushed twice a second for '
        '{seconds:g} s, so that plans are made at 5 Hz.',
        {'warm_replans': 1000, 'cold_replans': 300, 'replans': 10_000, 'seconds': 30.0},
        {'warm_replans': 4, 'cold_replans': 2, 'replans': 120, 'seconds': 4.0},
        900.0,
    ),
    Section(
        'live',
        'Live page',
        'The page of `tdm live` joins nodes that run, for {seconds:g} s: the pendulum at 200 Hz, '
        'replanned at 5 Hz while it is pushed twice a second, and twelve robots whose states are '
        'played, their planner asked for a plan five times a second. Frames are those that reach '
        "a browser's connection; the page's share of one core is processor time.",
        {'seconds': 20.0},
        {'seconds': 4.0},
        300.0,
    ),
    Section(
        'peers',
        'Peers',
        'The same problems, solved in one process on one core by this package and by what users '
        'would reach for otherwise, {cases} cases of each problem, in turn. Times are processor '
        'times.',
        {'cases': 100},
        {'cases': 1},
        1200.0,
    ),
)
SECTIONS: Mapping[str, Section] = MappingProxyType({each.name: each for each in _SECTIONS})

# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Planned against achieved: the figures of a mission's summary, and the histories behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tdm_sim.report.entries import Entry, Kind
from tdm_sim.report.goal_entries import cost_entries, duration_entries, landing_entries
from tdm_sim.report.limit_entries import (
    distance_entries,
    margin_entries,
    planner_entries,
    tracking_entries,
)
from tdm_sim.report.margins import History, limits_of, margin_history, separations
from tdm_sim.report.mission import Mission, Signals
from tdm_sim.report.outcome import arrival, tracking_errors, verdict
from tdm_sim.verdict import Verdict

__all__ = ['Comparison', 'Entry', 'Kind', 'compare']


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    What a report shows beside the mission itself.

    `entries` stand in the order of the summary; `margins` and `tracking_errors` are by vehicle;
    `separations` are distances of pairs, `minimum_separation` what they must keep [m]; `verdict`
    is the demo's judgement, None where not enough was recorded for one; `missing` says what could
    not be computed.
    """

    entries: tuple[Entry, ...]
    margins: Mapping[str, History] = field(default_factory=dict)
    separations: History = field(default_factory=History)
    minimum_separation: float | None = None
    tracking_errors: Mapping[str, Signals] = field(default_factory=dict)
    verdict: Verdict | None = None
    missing: tuple[str, ...] = ()

    def of(self, kind: Kind, vehicle: str | None = None) -> tuple[Entry, ...]:
        """Return the entries of a kind, of one vehicle if it is given."""
        return tuple(
            entry
            for entry in self.entries
            if entry.kind == kind and (vehicle is None or entry.vehicle == vehicle)
        )


def compare(mission: Mission) -> Comparison:
    """Compare what was planned with what was achieved."""
    limits = limits_of(mission)
    margins = {v.name: margin_history(v, limits) for v in mission.vehicles}
    apart = separations(mission)
    errors = {vehicle.name: tracking_errors(vehicle) for vehicle in mission.vehicles}
    arrivals = {vehicle.name: arrival(vehicle) for vehicle in mission.vehicles}
    minimum = mission.number('arena.minimum_separation')
    known = {name: error for name, error in errors.items() if error is not None}
    entries = [
        *duration_entries(mission, arrivals),
        *cost_entries(mission, limits, arrivals),
        *landing_entries(mission),
        *margin_entries(mission, margins),
        *distance_entries(mission, apart, minimum),
        *tracking_entries(known),
        *planner_entries(mission),
    ]
    return Comparison(
        entries=tuple(entries),
        margins=margins,
        separations=apart,
        minimum_separation=minimum,
        tracking_errors=known,
        verdict=verdict(mission, limits) if mission.was_carried_out else None,
        missing=(limits.fault,) if limits.fault else (),
    )

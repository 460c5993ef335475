# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The direct method itself, free of any plant: sections 2 and 3 of Yakimenko (2006)."""

from tdm_planner.direct_method.nonlinear_program import (
    Budget,
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.polynomial import PolynomialBasis, PolynomialReference
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions

__all__ = [
    'Budget',
    'Linearisation',
    'Minimum',
    'Multipliers',
    'NonlinearProgram',
    'Point',
    'PolynomialBasis',
    'PolynomialReference',
    'TrustRegionOptions',
    'minimise',
]

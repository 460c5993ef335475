# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is needed of a plant: its equations of motion x' = f(x, u), and what follows from them."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, ClassVar, Protocol

import numpy as np
from tdm_planner.arrays import Array

SIMULATION_STEP = 1e-3  # s


class Named(Protocol):
    """Names and units (SI) of states and controls, in the order of their arrays."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the nx states."""

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of the nx states."""

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the nu controls."""

    @property
    def control_units(self) -> tuple[str, ...]:
        """Units of the nu controls."""


class Plant(Named, Protocol):
    """Equations of motion in time, vectorised over leading axes."""

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., nx), (..., nu) -> (..., nx)."""


class SymbolicPlant:
    """
    A plant whose equations of motion are stated once, as a function of numbers.

    `equations` takes the plant's `coefficients` and sequences of its states and controls, and
    returns the rates of the states. It calls numpy's functions only.
    """

    state_names: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]
    equations: ClassVar[Callable[..., tuple[Any, ...]]]

    @property
    def coefficients(self) -> Any:
        """Constants of the equations of motion, a named tuple."""
        raise NotImplementedError

    def derivative(self, state: Array, control: Array) -> Array:
        """Time derivative of the states: (..., nx), (..., nu) -> (..., nx)."""
        if state.ndim == 1 and control.ndim == 1:
            # One state at a time is what integrators ask for: scalars are ten times faster.
            states, controls = state.tolist(), control.tolist()
            if not math.isfinite(sum(states)):
                return np.full(state.size, np.nan)
            return np.array(self.equations(self.coefficients, states, controls))
        rates = self.equations(self.coefficients, *_components(state, control))
        return np.stack(np.broadcast_arrays(*rates), axis=-1)

    def jacobians(self, state: Array, control: Array) -> tuple[Array, Array]:
        """Return df/dx (..., nx, nx) and df/du (..., nx, nu)."""
        # Where nothing is derived there is no use for what kernels and derivatives are kept with.
        from tdm_planner.plants.slopes import with_slopes

        k, nx, nu = self.coefficients, len(self.state_names), len(self.control_names)
        kind: Any = type(k)
        derived = with_slopes(self.equations, ('state', 'control'), k=kind, state=nx, control=nu)
        shape = np.broadcast_shapes(state.shape[:-1], control.shape[:-1])
        if not shape:
            slopes = derived(k, state.tolist(), control.tolist())[nx:]
            jacobians = np.array(slopes).reshape(nx + nu, nx).T
        else:
            slopes = derived(k, *_components(state, control))[nx:]
            jacobians = np.empty((*shape, nx, nx + nu))
            for place, slope in enumerate(slopes):
                jacobians[..., place % nx, place // nx] = slope
        return jacobians[..., :nx], jacobians[..., nx:]


def _components(state: Array, control: Array) -> tuple[Array, Array]:
    return np.moveaxis(state, -1, 0), np.moveaxis(control, -1, 0)


def runge_kutta_step(plant: Plant, state: Array, control: Array, step: float) -> Array:
    """Advance states (..., nx) by `step` s under held controls (..., nu); error O(step^5)."""
    k1 = plant.derivative(state, control)
    k2 = plant.derivative(state + 0.5 * step * k1, control)
    k3 = plant.derivative(state + 0.5 * step * k2, control)
    k4 = plant.derivative(state + step * k3, control)
    return state + step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def integrate(
    plant: Plant,
    state: Array,
    control: Array,
    duration: float,
    largest_step: float = SIMULATION_STEP,
) -> Array:
    """
    State(s) after `duration` s under held control(s), in equal steps of at most `largest_step`.

    By the classical Runge-Kutta method, for simulated plants and predictions.

    A duration of zero returns the state unchanged; a negative one raises ValueError.
    """
    if duration < 0.0:
        raise ValueError(f'cannot integrate over a negative duration of {duration} s')
    # Rounding must not cost a step: 0.005 / 0.001 is 5.000000000000001 at times.
    steps = math.ceil(duration / largest_step * (1.0 - 1e-12))
    for _ in range(steps):
        state = runge_kutta_step(plant, state, control, duration / steps)
    return state

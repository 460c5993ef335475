# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Draws Fig. 1 of Yakimenko (2006): what the free parameters of a reference function do.

Two coordinates with position, velocity and acceleration given at both ends, as the quintics
(2)-(4) of the virtual arc. (a) only its length tau_f is varied; (b) the final second derivative
of the first coordinate as well.

Run it: ``python docs/paper/figure_1.py [FILE.png]``.
"""

from __future__ import annotations

from pathlib import Path
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly

START = (0.0, 1.0, 0.0), (0.0, 0.2, 0.1)  # x, x', x'' of either coordinate
END = (4.0, 0.3, 0.0), (3.0, 1.0, 0.0)
ARCS = (2.0, 4.0, 6.0, 8.0, 10.0)
CURVATURES = (-1.0, 0.0, 1.0)


def path(tau_f: float, curvature: float = 0.0) -> NDArray[np.float64]:
    """Return the path, (101, 2), for an arc's length tau_f and a final x_1'' of `curvature`."""
    tau = np.linspace(0.0, tau_f, 101)
    ends = (*END[0][:2], curvature), END[1]
    both = zip(START, ends, strict=True)
    return np.stack([BPoly.from_derivatives([0.0, tau_f], pair)(tau) for pair in both], axis=1)


def draw(file: Path) -> None:
    """Write the figure."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4), sharey=True)
    for tau_f in ARCS:
        left.plot(*path(tau_f).T, label=rf'$\tau_f$ = {tau_f:g}')
    for tau_f, style in ((4.0, '-'), (8.0, '--')):
        for curvature in CURVATURES:
            label = rf"$\tau_f$ = {tau_f:g}, $x''_{{1f}}$ = {curvature:g}"
            right.plot(*path(tau_f, curvature).T, style, label=label)
    titles = (r'(a) $\tau_f$ varied', r"(b) $\tau_f$ and $x''_{1f}$ varied")
    for axes, title in zip((left, right), titles, strict=True):
        axes.set(title=title, xlabel='$x_1$', aspect='equal', xlim=(-0.2, 4.6), ylim=(-0.2, 3.2))
        axes.legend(fontsize=7)
    left.set_ylabel('$x_2$')
    figure.tight_layout()
    figure.savefig(file, dpi=120)
    pyplot.close(figure)


if __name__ == '__main__':
    written = Path(sys.argv[1] if len(sys.argv) > 1 else 'figure_1.png')
    draw(written)
    print(f'written: {written.resolve()}')

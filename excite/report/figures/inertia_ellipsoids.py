"""Figure of each link's inertia before and after, as an ellipsoid of uniform density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import FloatArray
from ...identification.inertia_distance import Distance, NominalFrames
from ...robot.inertial_parameters import pseudo_inertia
from .drawing import BLUE, GREY, INK, SOFT, render_svg
from .trajectory import short

VIEWS = ((0, 1), (0, 2), (1, 2))
_AXES = "xyz"
_VIEW_SIZE = 1.28
"""Width and height of a view [in]."""
_LINKS_PER_ROW = 2


@dataclass(frozen=True)
class LinkBody:
    """Ten inertial parameters of a link in its joint's frame; phi: shape (10,)."""

    phi: FloatArray

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.phi[0])

    @property
    def centre(self) -> FloatArray:
        """Centre of mass. Shape (3,) [m]."""
        return np.asarray(self.phi[1:4] / self.phi[0])

    @property
    def shape(self) -> FloatArray:
        """Matrix E of the ellipsoid {c + x: xᵀ E⁻¹ x ≤ 1} of uniform density. Shape (3, 3) [m²]."""
        return np.asarray(
            5.0
            * (pseudo_inertia(self.phi)[:3, :3] / self.mass - np.outer(self.centre, self.centre))
        )

    @property
    def half_axes(self) -> FloatArray:
        """Half axes of the ellipsoid, the longest first. Shape (3,) [m]."""
        return np.sqrt(np.maximum(np.linalg.eigvalsh(self.shape)[::-1], 0.0))

    def outline(self, view: tuple[int, int], points: int = 64) -> FloatArray:
        """Projection of the ellipsoid on the plane of two axes. Shape (points, 2) [m]."""
        index = list(view)
        values, vectors = np.linalg.eigh(self.shape[np.ix_(index, index)])
        angle = np.linspace(0.0, 2.0 * np.pi, points)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        return np.asarray(
            self.centre[index] + ((vectors * np.sqrt(np.maximum(values, 0.0))) @ circle).T
        )


@dataclass(frozen=True)
class LinkBodyChange:
    """Inertia of a link, nominal and identified; share: identifiable share of its parameters."""

    link: str
    before: LinkBody
    after: LinkBody
    share: float | None

    @property
    def distance(self) -> float:
        """Affine-invariant distance of both: 0.07 for a mass by about 10 %."""
        return float(
            np.sqrt(
                max(
                    NominalFrames(self.before.phi[None])
                    .squared_distance(Distance.RIEMANNIAN, self.after.phi[None])
                    .value[0],
                    0.0,
                )
            )
        )

    @property
    def shift(self) -> float:
        """Displacement of the centre of mass [m]."""
        return float(np.linalg.norm(self.after.centre - self.before.centre))


def draw_ellipsoids(changes: Sequence[LinkBodyChange]) -> str:
    """Draw three views of every link's ellipsoid before and after, one scale for a link."""
    columns = min(_LINKS_PER_ROW, len(changes))
    rows = -(-len(changes) // columns)
    step = _VIEW_SIZE + 0.5
    height = 0.3 + rows * step
    block = 3 * (_VIEW_SIZE + 0.35) + 0.3

    def draw(figure: Any) -> None:
        width = figure.get_size_inches()[0]
        for k, change in enumerate(changes):
            row, column = divmod(k, columns)
            half = _bounding_cube(change)
            for v, view in enumerate(VIEWS):
                left = 0.2 + column * block + v * (_VIEW_SIZE + 0.35)
                bottom = height - 0.3 - row * step - 0.2 - _VIEW_SIZE
                axes = figure.add_axes(
                    (left / width, bottom / height, _VIEW_SIZE / width, _VIEW_SIZE / height)
                )
                _view(axes, change, view, half)
                if v == 0:
                    axes.set_title(_heading(change), loc="left", fontweight="bold", pad=4)
                    _scale_bar(axes, half)
        _legend(figure)

    return render_svg(
        "Inertia ellipsoid of every link before and after, in three views", height, draw
    )


def _heading(change: LinkBodyChange) -> str:
    """Link with its mass before and after."""
    return f"{short(change.link)}: {change.before.mass:.3g} → {change.after.mass:.3g} kg"


def _bounding_cube(change: LinkBodyChange) -> tuple[FloatArray, float]:
    """Middle and half width of a cube that holds both ellipsoids and the joint."""
    spread = [
        np.sqrt(np.maximum(np.diag(body.shape), 0.0)) for body in (change.before, change.after)
    ]
    low = np.min(
        [
            np.zeros(3),
            *(b.centre - s for b, s in zip((change.before, change.after), spread, strict=True)),
        ],
        axis=0,
    )
    high = np.max(
        [
            np.zeros(3),
            *(b.centre + s for b, s in zip((change.before, change.after), spread, strict=True)),
        ],
        axis=0,
    )
    return 0.5 * (low + high), 0.54 * max(float((high - low).max()), 1e-4)


def _view(
    axes: Any, change: LinkBodyChange, view: tuple[int, int], reach: tuple[FloatArray, float]
) -> None:
    """Draw one view of both ellipsoids."""
    middle, half = reach
    axes.axhline(0.0, color="#dfe4e9", linewidth=0.6, zorder=0)
    axes.axvline(0.0, color="#dfe4e9", linewidth=0.6, zorder=0)
    axes.plot(0.0, 0.0, "+", color=SOFT, markersize=6, zorder=1)
    before, after = change.before.outline(view), change.after.outline(view)
    axes.fill(before[:, 0], before[:, 1], color=GREY, alpha=0.25, linewidth=0.0, zorder=2)
    axes.plot(before[:, 0], before[:, 1], color=SOFT, linewidth=0.9, dashes=(4, 2), zorder=3)
    axes.fill(after[:, 0], after[:, 1], color=BLUE, alpha=0.15, linewidth=0.0, zorder=2)
    axes.plot(after[:, 0], after[:, 1], color=BLUE, linewidth=1.3, zorder=4)
    index = list(view)
    axes.plot(*change.before.centre[index], "x", color=SOFT, markersize=4.5, zorder=5)
    axes.plot(*change.after.centre[index], "o", color=BLUE, markersize=3.5, zorder=6)
    axes.set_xlim(middle[view[0]] - half, middle[view[0]] + half)
    axes.set_ylim(middle[view[1]] - half, middle[view[1]] + half)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(True)
        side.set_color("#e3e8ee")
    axes.set_xlabel(_AXES[view[0]], labelpad=1.5)
    axes.set_ylabel(_AXES[view[1]], labelpad=1.5, rotation=0)


def _scale_bar(axes: Any, reach: tuple[FloatArray, float]) -> None:
    """A bar of round length in the lower left corner."""
    middle, half = reach
    power = 10.0 ** np.floor(np.log10(half))
    length = max(s * power for s in (0.1, 0.2, 0.5, 1.0) if s * power <= 0.8 * half)
    x, y = middle[0] - 0.93 * half, middle[1] - 0.9 * half
    axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6, solid_capstyle="butt", zorder=7)
    text = f"{100.0 * length:g} cm" if length >= 0.01 else f"{1000.0 * length:g} mm"
    axes.annotate(text, (x, y), (0, 2.5), textcoords="offset points", fontsize=6.5, zorder=7)


def _legend(figure: Any) -> None:
    """Legend of all views."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=SOFT, dashes=(4, 2), marker="x", markersize=4.5),
        Line2D([], [], color=BLUE, marker="o", markersize=3.5),
        Line2D([], [], color=SOFT, marker="+", linestyle="none"),
    ]
    labels = ["nominal", "identified", "joint frame"]
    figure.legend(
        handles, labels, loc="upper right", ncols=3, bbox_to_anchor=(0.995, 1.0), borderaxespad=0.0
    )

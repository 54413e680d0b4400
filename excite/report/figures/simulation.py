"""Torque of a simulated robot with and without its hidden effects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import svg
from .drawing import BLUE, GREY, ORANGE, axes_grid, limit_ticks, render_svg, thin_curve

DRAWN_POINTS = 1200
"""Points of a curve; more are not visible at the width of the figure."""


def torque_with_and_without_effects(
    recording: Any, undisturbed: Any, effects: tuple[Any, ...], units: Mapping[str, str]
) -> str:
    """Draw recorded torque, torque without effects, and their difference, one row a joint, as SVG.

    Args:
        recording: The simulated recording.
        undisturbed: The same run without the hidden effects and without noise.
        effects: The hidden effects.
        units: Unit of the torque of each joint, "N m" or "N".
    """
    joints, t = recording.joints, recording.t
    plain = undisturbed.torque(t)
    change = recording.tau - plain
    hidden = " + ".join(effect.name for effect in effects) or "nothing hidden"

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, len(joints), 2, margins=(0.65, 0.15, 0.45, 0.4), gaps=(0.6, 0.22))
        for j, joint in enumerate(joints):
            left, right = axes[j]
            left.plot(
                *thin_curve(t, recording.tau[:, j], DRAWN_POINTS), color=BLUE, label="recorded"
            )
            left.plot(
                *thin_curve(t, plain[:, j], DRAWN_POINTS),
                color=ORANGE,
                label="the same robot, nothing hidden, no noise",
            )
            right.plot(*thin_curve(t, change[:, j], DRAWN_POINTS), color=GREY, label="difference")
            left.set_ylabel(units[joint])
            left.set_title(joint, loc="left", pad=3)
            for axis in (left, right):
                limit_ticks(axis, 6)
                axis.set_xlim(0.0, t[-1])
                axis.tick_params(labelbottom=j == len(joints) - 1)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        axes[0, 1].set_title(f"difference: {hidden}, and noise", loc="right", pad=3)
        for axis in axes[-1]:
            axis.set_xlabel("t [s]")

    height = 0.85 + 1.15 * len(joints)
    return svg.standalone(render_svg(f"Torque with and without {hidden}", height, draw))

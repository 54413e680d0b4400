"""Directions of the parameters in words that a roboticist understands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .._types import FloatArray
from .inertial_parameters import INERTIAL, Parameters

SMALLEST_SHARE = 0.01
"""Share of a direction below which a parameter is not mentioned [1]."""
_AXES = {"mcx": "x", "mcy": "y", "mcz": "z"}
_ABOUT = {"Ixx": "x", "Iyy": "y", "Izz": "z"}
DRIVE_WORDS = {
    "rotor_inertia": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "offset": "torque offset",
}
"""Joint parameters in words."""


def sentence(
    parameters: Parameters, shares: FloatArray, variance: float, identifiable: bool
) -> str:
    """Describe a direction: its parameters and how well they are determined.

    Args:
        parameters: The standard parameters.
        shares: Squared components of the direction's unit vector. Shape (P,).
        variance: Variance of the parameters along the direction, relative to the metric [1].
        identifiable: Whether it is below the threshold.
    """
    groups = sorted(_groups(parameters, shares), key=lambda g: -g[1])
    first, share = groups[0]
    minor = [f"{text} ({100 * s:.0f} %)" for text, s in groups[1:4] if s >= 0.08]
    if share < 0.5:
        what = f"a mix of {listed([f'{first} ({100 * share:.0f} %)', *minor])}"
    else:
        lead = first if share >= 0.9 else f"mostly {first} ({100 * share:.0f} %)"
        what = lead + (f", with {listed(minor)}" if minor else "")
    if identifiable:
        return f"{what}; seen to ±{percent(np.sqrt(variance))}"
    if not np.isfinite(variance):
        return f"not seen: {what}; this motion does not excite it at all"
    if variance >= 1.0:
        return f"not seen: {what}; what one would fit is noise (±{percent(np.sqrt(variance))})"
    return f"not seen: {what}; known only to ±{percent(np.sqrt(variance))}"


def percent(share: float) -> str:
    """A share as a percentage with two digits, such as '2.3 %' or '340 %'; '∞' and '–' (not a
    number) where it is not finite."""
    if not np.isfinite(share):
        return "–" if np.isnan(share) else "∞"
    value = float(f"{100.0 * share:.2g}")
    return (
        f"{value:g} %" if value < 1e5 else f"{value:.0e} %".replace("e+0", "e").replace("e+", "e")
    )


def multiple(ratio: float) -> str:
    """How many times something is something else, such as '1.02'; '∞' where that is 0."""
    return f"{ratio:.2f}" if np.isfinite(ratio) else "∞"


def _groups(parameters: Parameters, shares: FloatArray) -> list[tuple[str, float]]:
    """Usual names of the parameters, each with its share: the mass of a link, its centre of mass
    along x …"""
    out = []
    for i, link in enumerate(parameters.links):
        block = dict(zip(INERTIAL, shares[10 * i : 10 * i + 10], strict=True))
        out.append((f"the mass of {link}", float(block["m"])))
        centre = {axis: float(block[key]) for key, axis in _AXES.items()}
        total = sum(centre.values())
        out.append((f"the centre of mass of {link} along {_leading(centre)}", total))
        moments = {axis: float(block[key]) for key, axis in _ABOUT.items()}
        products = float(block["Ixy"] + block["Ixz"] + block["Iyz"])
        inertia = sum(moments.values()) + products
        kind = "the products of inertia of" if products > 0.6 * inertia else "the inertia of"
        about = f" about {_leading(moments)}" if products <= 0.6 * inertia else ""
        out.append((f"{kind} {link}{about}", inertia))
    start, n = 10 * parameters.bodies, len(parameters.joints)
    for k, kind in enumerate(parameters.drive):
        out += [
            (f"the {DRIVE_WORDS[kind]} of {joint}", float(shares[start + k * n + j]))
            for j, joint in enumerate(parameters.joints)
        ]
    return out


def _leading(shares: Mapping[str, float]) -> str:
    """The axes that matter, the first first: 'x', 'x and z'."""
    total = sum(shares.values())
    order = sorted(shares, key=lambda axis: -shares[axis])
    kept = [axis for k, axis in enumerate(order) if k == 0 or shares[axis] > 0.25 * total]
    return listed(kept)


def plural(count: int, noun: str) -> str:
    """Format a count with its noun: '1 joint', '3 joints'."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def listed(words: list[str]) -> str:
    """Words in a sentence: 'a, b and c'."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def some(words: Sequence[str], most: int = 3) -> str:
    """Joints, if they are at most so many; else how many."""
    return listed(list(words)) if len(words) <= most else f"{len(words)} joints"


def spoken(name: str, parameters: Parameters) -> str:
    """A parameter's name in words: 'mcx3' is 'm·c along x of wrist_1_link'."""
    index = parameters.names.index(name)
    owner = parameters.owners()[index]
    if index >= 10 * parameters.bodies:
        kind = parameters.drive[(index - 10 * parameters.bodies) // len(parameters.joints)]
        return f"{DRIVE_WORDS[kind]} of {owner}"
    symbol = INERTIAL[index % 10]
    if symbol == "m":
        return f"mass of {owner}"
    return f"m·c along {_AXES[symbol]} of {owner}" if symbol in _AXES else f"{symbol} of {owner}"

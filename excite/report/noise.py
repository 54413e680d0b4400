"""Is the noise white, and which band was used? What the uncertainty rests on."""

from __future__ import annotations

import numpy as np

from ..identification.friction_width import CANDIDATE_WIDTHS
from ..identification.identification import Identification
from ..identification.lowpass import TAPER_FRACTION
from ..identification.segments import DEFAULT_BAND_HZ
from ..robot.parameter_names import listed, percent
from .figures import noise as noise_module
from .figures.noise import INTERVAL, Densities
from .figures.trajectory import is_prismatic, torque_units
from .page import Section, escape, figure, number, paragraph, table

Array = np.ndarray
WHITE = 2.0
"""Ratio of the strongest to the weakest quarter of the band up to which noise counts as white."""


def residual(found: Identification) -> Densities:
    """Density of what the fit leaves, in torque: the weighted residual's with the weights undone. Shape (F, n) [(N m)²/Hz]."""
    colour, scale = found.data.noise_spectrum, found.data.noise_root
    kept = colour.frequency <= found.spectra.hertz
    return Densities(
        colour.frequency[kept], (colour.density @ (scale**2).T * (2.0 / found.equations.rate))[kept]
    )


def slants(density: Densities) -> Array:
    """Of each joint, the mean density in the strongest quarter of the band over that in the weakest. Shape (n,).

    Without the band's last part, which the filter takes off where nothing repeats.
    """
    inside = density.power[density.frequency <= (1.0 - TAPER_FRACTION) * density.frequency[-1]]
    quarters = np.array([part.mean(axis=0) for part in np.array_split(inside, min(4, len(inside)))])
    return np.asarray(quarters.max(axis=0) / np.maximum(quarters.min(axis=0), 1e-300))


def section(found: Identification) -> Section:
    """Spectra with the band, whiteness of the residual, delays, widths of Coulomb friction."""
    robot, spectra = found.model.robot, found.spectra
    left = residual(found)
    slant = slants(left)
    coloured = [j for j, s in zip(robot.joints, slant, strict=True) if s > WHITE]
    most = int(np.argmax(slant))
    if coloured:
        which = (
            "No"
            if len(coloured) == robot.n
            else f"Not in {listed(coloured) if len(coloured) <= 3 else f'{len(coloured)} joints'}"
        )
        answer = f"{which}: in {robot.joints[most]} the residual is {_times(slant[most])} times as strong in one quarter of the band "
        answer += "as in another, which the intervals allow for"
    else:
        answer = f"Yes, within a factor of {max(slant[most], 1.05):.2g} over the band"
    answer += f"; the band ends at {number(spectra.hertz, 3)} Hz, {_band_words(found)}."
    longest = max(
        zip(found.equations.stretches(), found.equations.periods, strict=True),
        key=lambda pair: pair[0].stop - pair[0].start,
    )
    periods = longest[1]
    noise = Densities(spectra.frequency, spectra.noise / max(periods, 1))
    words = (
        f"spread of the mean of {periods} periods"
        if periods
        else "noise: median torque density at high frequencies"
    )
    svg = noise_module.spectra(
        robot.joints,
        Densities(spectra.frequency, spectra.torque),
        noise,
        left,
        spectra.hertz,
        words,
    )
    clock = noise_module.clock(
        robot.joints,
        found.delay,
        found.model.widths,
        (CANDIDATE_WIDTHS[0], CANDIDATE_WIDTHS[-1]),
        is_prismatic(robot),
    )
    body = (
        figure(svg)
        + paragraph(_note(found), "note")
        + figure(clock)
        + _table(found, slant, periods)
        + paragraph(_delay_words(found), "note")
    )
    return Section("noise", "Is the noise white, and which band was used?", answer, body)


def _times(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.1f}"


def _band_words(found: Identification) -> str:
    """Why the band ends where it does."""
    spectra = found.spectra
    if found.options.band is not None:
        return "as asked for"
    if np.isclose(spectra.hertz, DEFAULT_BAND_HZ):
        return "as usual"
    slow = "beyond it torque drowns in its noise, or the recording's rate allows no more"
    why = "the motion is fast" if spectra.hertz > DEFAULT_BAND_HZ else slow
    return f"chosen from the data: {why} (99 % of the motion's power lies below {number(spectra.motion, 3)} Hz)"


def _note(found: Identification) -> str:
    text = "Power density in (N m)²/Hz, beyond the dashed line (grey) nothing was fitted. White noise is a level line. "
    text += "A residual above the noise is physics that the model lacks, or noise that repeats with the motion."
    untrue = [
        j
        for j, same in zip(
            found.model.robot.joints, found.data.noise_spectrum.repeated, strict=True
        )
        if not same
    ]
    if any(found.equations.periods) and untrue:
        text += f" In {listed(untrue)} the residual is larger than the spread between periods explains: something repeatable is left."
    return text


def _table(found: Identification, slant: Array, periods: int) -> str:
    rows = [
        (
            escape(joint),
            f"{number(found.data.noise[k], 3)} {unit}",
            "–" if found.noise_floor is None else f"{number(found.noise_floor[k], 3)} {unit}",
            _times(slant[k]),
            f"{number(1e3 * found.delay.seconds[k], 2)} ± {number(1e3 * INTERVAL * found.delay.deviation[k], 2)}",
            number(1e3 * found.model.widths[k], 2) + _edge(float(found.model.widths[k])),
        )
        for k, (joint, unit) in enumerate(
            zip(found.model.robot.joints, torque_units(found.model.robot), strict=True)
        )
    ]
    step = (
        "friction's step [mm/s]"
        if all(is_prismatic(found.model.robot))
        else "friction's step [mrad/s]"
    )
    left = f"left by the fit (mean of {periods})" if periods else "left by the fit"
    head = ("joint", left, "noise floor", "strongest / weakest quarter", "delay [ms]", step)
    return table(head, rows, (1, 2, 3, 4, 5))


def _edge(width: float) -> str:
    if np.isclose(width, CANDIDATE_WIDTHS[0]):
        return " or less"
    return " or more" if np.isclose(width, CANDIDATE_WIDTHS[-1]) else ""


def _delay_words(found: Identification) -> str:
    mean, deviation = found.delay.common
    common = f"{number(1e3 * mean, 2)} ± {number(1e3 * INTERVAL * deviation, 2)} ms"
    text = f"If all joints share one clock, torque is {common} later than position. "
    alike = float(
        np.sum(((found.delay.seconds - mean) / np.maximum(found.delay.deviation, 1e-12)) ** 2)
    )
    if len(found.delay.seconds) > 1 and alike > 4.0 * len(found.delay.seconds):
        text += "The joints do not agree on it, so it is no delay of the whole clock. "
    moved = "Torque was moved by each joint's delay before the fit."
    text += moved if found.options.align else "It was left as recorded (--align removes it)."
    if found.data.outliers > 0.0:
        text += f" Robust estimation halved the weight of {percent(found.data.outliers)} of the rows or more than halved it."
    return text

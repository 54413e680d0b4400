"""Noise, band, delays and Coulomb friction widths of an identification."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from .._types import FloatArray
from ..identification.friction_width import CANDIDATE_WIDTHS
from ..identification.identification import Identification
from ..identification.lowpass import TAPER_FRACTION
from ..identification.segments import DEFAULT_BAND_HZ
from ..robot.parameter_names import listed, percent
from .content import Section, Table
from .figures import noise as noise_figures
from .figures.noise import NORMAL_QUANTILE, PowerDensities
from .figures.trajectory import is_prismatic, torque_units
from .formatting import number

WHITE_RATIO = 2.0
"""Ratio of the strongest to the weakest quarter of the band up to which noise counts as white."""
NAMED_JOINTS = 3
"""Joints that are named in an answer; more are only counted."""
DELAY_DISAGREEMENT = 4.0
"""Mean squared deviation of the joints' delays from the common delay, in squared standard errors,
from which they disagree: two standard errors each."""


def residual_density(identification: Identification) -> PowerDensities:
    """Power density of the fit's residual in torque units, with the weights of the fit undone."""
    spectrum, root = identification.data.noise_spectrum, identification.data.noise_root
    kept = spectrum.frequency <= identification.spectra.hertz
    power = spectrum.density @ (root**2).T * (2.0 / identification.equations.rate)
    return PowerDensities(spectrum.frequency[kept], power[kept])


def density_ratios(density: PowerDensities) -> FloatArray:
    """Mean density in the strongest quarter of the band over that in the weakest.

    The end of the band, which the low-pass filter attenuates, is left out. Shape (n,).
    """
    flat_end = (1.0 - TAPER_FRACTION) * density.frequency[-1]
    inside = density.power[density.frequency <= flat_end]
    quarters = np.array([part.mean(axis=0) for part in np.array_split(inside, min(4, len(inside)))])
    return np.asarray(quarters.max(axis=0) / np.maximum(quarters.min(axis=0), 1e-300))


def noise_section(identification: Identification) -> Section:
    """Build the section on spectra, whiteness, delays and widths of Coulomb friction."""
    robot, spectra = identification.model.robot, identification.spectra
    equations = identification.equations
    density = residual_density(identification)
    ratios = density_ratios(density)
    _, periods = max(
        zip(equations.stretches(), equations.periods, strict=True),
        key=lambda pair: pair[0].stop - pair[0].start,
    )
    noise_words = (
        f"spread of the mean of {periods} periods"
        if periods
        else "noise: median torque density at high frequencies"
    )
    spectra_figure = noise_figures.draw_spectra(
        robot.joints,
        PowerDensities(spectra.frequency, spectra.torque),
        PowerDensities(spectra.frequency, spectra.noise / max(periods, 1)),
        density,
        spectra.hertz,
        noise_words,
    )
    delay_figure = noise_figures.draw_delays(
        robot.joints,
        identification.delay,
        identification.model.widths,
        (CANDIDATE_WIDTHS[0], CANDIDATE_WIDTHS[-1]),
        is_prismatic(robot),
    )
    is_repeated = zip(robot.joints, identification.data.noise_spectrum.repeated, strict=True)
    systematic = [joint for joint, repeated in is_repeated if not repeated]
    data = {
        "spectra": Markup(spectra_figure),
        "delays": Markup(delay_figure),
        "systematic": listed(systematic) if any(equations.periods) and systematic else "",
        "table": _noise_table(identification, ratios, periods),
        "delay": _delay_facts(identification),
    }
    question = "Is the noise white, and which band was used?"
    return Section("noise", question, _noise_answer(identification, ratios), data)


def _noise_answer(identification: Identification, ratios: FloatArray) -> str:
    """Whiteness of the residual, and the end of the band."""
    joints, hertz = identification.model.robot.joints, identification.spectra.hertz
    coloured = [j for j, ratio in zip(joints, ratios, strict=True) if ratio > WHITE_RATIO]
    worst = int(np.argmax(ratios))
    if coloured:
        which = "No"
        if len(coloured) < len(joints):
            few = len(coloured) <= NAMED_JOINTS
            which = f"Not in {listed(coloured) if few else f'{len(coloured)} joints'}"
        answer = (
            f"{which}: in {joints[worst]} the residual is {_times(ratios[worst])} times as strong "
            "in one quarter of the band as in another, which the intervals allow for"
        )
    else:
        answer = f"Yes, within a factor of {max(ratios[worst], 1.05):.2g} over the band"
    return f"{answer}; the band ends at {number(hertz, 3)} Hz, {_band_reason(identification)}."


def _times(ratio: float) -> str:
    """Format a ratio of densities."""
    return f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.1f}"


def _band_reason(identification: Identification) -> str:
    """Reason for the end of the band."""
    spectra = identification.spectra
    if identification.options.band is not None:
        return "as requested"
    if np.isclose(spectra.hertz, DEFAULT_BAND_HZ):
        return "the default"
    slow = "above it the torque is below its noise, or the sampling rate allows no more"
    reason = "the motion is fast" if spectra.hertz > DEFAULT_BAND_HZ else slow
    power = f"99 % of the motion's power lies below {number(spectra.motion, 3)} Hz"
    return f"chosen from the data: {reason} ({power})"


def _noise_table(identification: Identification, ratios: FloatArray, periods: int) -> Table:
    """Noise, delay and friction width of each joint."""
    robot, delay = identification.model.robot, identification.delay
    widths, floor = identification.model.widths, identification.noise_floor
    rows = []
    for k, (joint, unit) in enumerate(zip(robot.joints, torque_units(robot), strict=True)):
        error = NORMAL_QUANTILE * delay.deviation[k]
        rows.append(
            (
                joint,
                f"{number(identification.data.noise[k], 3)} {unit}",
                "–" if floor is None else f"{number(floor[k], 3)} {unit}",
                _times(ratios[k]),
                f"{number(1e3 * delay.seconds[k], 2)} ± {number(1e3 * error, 2)}",
                number(1e3 * widths[k], 2) + _bound_words(float(widths[k])),
            )
        )
    unit = "mm/s" if all(is_prismatic(robot)) else "mrad/s"
    residual = f"residual of the fit (mean of {periods})" if periods else "residual of the fit"
    head = (
        "joint",
        residual,
        "noise floor",
        "strongest / weakest quarter",
        "delay [ms]",
        f"Coulomb friction width [{unit}]",
    )
    return Table(head, rows, (1, 2, 3, 4, 5))


def _bound_words(width: float) -> str:
    """Mark a width at an end of the candidates."""
    if np.isclose(width, CANDIDATE_WIDTHS[0]):
        return " or less"
    return " or more" if np.isclose(width, CANDIDATE_WIDTHS[-1]) else ""


def _delay_facts(identification: Identification) -> dict[str, Any]:
    """The delay common to all joints, and whether they agree on it."""
    delay = identification.delay
    mean, deviation = delay.common
    spread = (delay.seconds - mean) / np.maximum(delay.deviation, 1e-12)
    count, outliers = len(delay.seconds), identification.data.outliers
    return {
        "common": f"{number(1e3 * mean, 2)} ± {number(1e3 * NORMAL_QUANTILE * deviation, 2)} ms",
        "disagrees": count > 1 and float(np.sum(spread**2)) > DELAY_DISAGREEMENT * count,
        "is_removed": identification.options.align,
        "outliers": percent(outliers) if outliers > 0.0 else "",
    }

"""The report of an identification: prediction, parameters, noise, and the next experiment."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

import numpy as np

from ..designer.identifiability import Direction
from ..identification import consistency
from ..identification.identification import Identification
from ..identification.link_estimates import link_estimates
from ..robot.inertial_parameters import DRIVE
from ..robot.parameter_names import percent, plural
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table
from .estimates import bodies_section, directions_section, parameters_section
from .formatting import number, uncapitalized
from .identifiability import without_verdict
from .noise import noise_section
from .prediction import prediction_section, prediction_verdict
from .remarks import RemarksByRecording, count_remarks, list_remarks
from .render import render

_METHODS = {
    "ols": "ordinary least squares",
    "wls": "least squares, weighted by each joint's noise",
    "full": "least squares, weighted by the covariance of the noise over the joints",
    "huber": "robust estimation (Huber), weighted by each joint's noise",
    "iv": "instrumental variables, weighted by each joint's noise",
}
_DISTANCES = {
    "riemannian": "affine-invariant Riemannian",
    "bregman": "log-determinant Bregman divergence",
    "pullback": "the metric at the nominal robot (quadratic)",
    "euclidean": "Euclidean, in SI units",
}


def identification_page(
    identification: Identification,
    remarks: RemarksByRecording | None = None,
) -> str:
    """Render the report of `excite identify` as HTML.

    Args:
        identification: The result.
        remarks: Remarks of the data-quality checks, by recording.
    """
    remarks = remarks or {}
    content = ReportContent(
        title=f"Identification of {identification.model.robot.name}",
        subtitle="Physically consistent parameters from recordings: how well they predict, how "
        "certain they are, and what to record next.",
        banners=[*_doubt_banners(remarks), *_banners(identification)],
        cards=_cards(identification),
        sections=[
            prediction_section(identification),
            parameters_section(identification),
            directions_section(identification),
            bodies_section(identification),
            noise_section(identification),
            _next_section(identification),
            _provenance_section(identification, remarks),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("identification", content)


# -- first screen ----------------------------------------------------------------------------------


def _doubt_banners(remarks: RemarksByRecording) -> list[Banner]:
    """Unrepaired doubts about the recordings: with them the figures below say little."""
    doubts = [remark.text for group in remarks.values() for remark in group if remark.doubt]
    if not doubts:
        return []
    more = f" ({len(doubts) - 1} more below, in the remarks)" if len(doubts) > 1 else ""
    text = f"Do not use this model: the recordings are doubted. {doubts[0]}{more}."
    return [Banner(text, "bad")]


def _banners(identification: Identification) -> list[Banner]:
    """Verdicts on the prediction and on physical consistency, and warnings."""
    parameters = identification.model.parameters
    verdict, tone = prediction_verdict(identification)
    banners = [Banner(f"Does it predict another recording? {verdict}", tone)]
    if consistency.is_consistent(parameters, identification.psi):
        text = "All links are physically consistent; friction and rotor inertia are not negative."
        banners.append(Banner(text, "good"))
    else:
        text = (
            "These parameters are NOT physically consistent: do not simulate or control with them."
        )
        banners.append(Banner(text, "bad"))
    if parameters.repaired:
        text = (
            f"The inertia of {', '.join(parameters.repaired)} in the URDF is not physically "
            "consistent; the prior uses a small substitute."
        )
        banners.append(Banner(text, "warn"))
    return banners


def _cards(identification: Identification) -> list[tuple[str, str]]:
    """Key figures of an identification."""
    robot = identification.model.robot
    predictions = identification.validations or identification.fits
    data = "held out" if identification.validations else "of the fit"
    before, after = (
        np.sqrt(
            sum(float(np.sum((p.measured - getattr(p, which))[p.moving] ** 2)) for p in predictions)
            / sum(float(np.sum(p.measured[p.moving] ** 2)) for p in predictions)
        )
        for which in ("nominal", "fitted")
    )
    shown = max(predictions, key=lambda p: float(p.relative()[p.limiting_joint()[0]]))
    joint, above = shown.limiting_joint()
    errors = f"{number(shown.error('nominal')[joint], 2)} → {number(shown.error()[joint], 2)}"
    reason = (
        "largest error over its torque"
        if above or shown.noise_floor is None
        else "most reduced; every joint is at its noise floor"
    )
    unit = robot.entries[joint].unit("N m").replace(" ", "\u00a0")
    return [
        (f"{percent(before)} → {percent(after)}", f"torque error of all joints, {data}"),
        (f"{errors}\u00a0{unit}", f"{robot.joints[joint]}, {reason}"),
        (
            f"{identification.analysis.identifiable_count} of {identification.model.base.count}",
            "directions identified",
        ),
        *_mass_cards(identification),
        (
            f"{len(identification.equations)} × {robot.n}",
            f"equations below {number(identification.spectra.hertz, 3)}\u00a0Hz",
        ),
    ]


def _mass_cards(identification: Identification) -> list[tuple[str, str]]:
    """Number of link masses that the data decide, and the heaviest of them."""
    links = link_estimates(
        identification.model.parameters, identification.posterior, identification.prior
    )
    decided = [link for link in links if not link.is_prior]
    cards = [(f"{len(decided)} of {len(links)}", "link masses decided by the data, not the prior")]
    if decided:
        heaviest = max(decided, key=lambda link: link.mass)
        cards.append(
            (
                f"{number(heaviest.mass, 3)} ± {number(heaviest.mass_deviation, 2)}\u00a0kg",
                f"{heaviest.name}, of which the data decide {100.0 * heaviest.mass_share:.0f} %",
            )
        )
    return cards


# -- next experiment -------------------------------------------------------------------------------


def next_design_command(identification: Identification) -> str:
    """Shell command that designs a motion for the directions not identified yet."""
    robot, drive = identification.model.robot, identification.model.parameters.drive
    words = ["excite", "design", robot.source]
    for fit in identification.fits:
        words += ["--given", fit.source]
    words += robot.command_options()
    missing = [kind for kind in DRIVE if kind not in drive]
    if len(missing) == len(DRIVE):
        words += ["--parameters", "inertial"]
    elif missing:
        words += ["--without", ",".join(missing)]
    return shlex.join([*words, "--validation", "-o", "next"])


def _next_section(identification: Identification) -> Section:
    """Command for the next design, and the directions that it is for."""
    weak = [d for d in identification.analysis.directions if not d.identifiable]
    if weak:
        worst = without_verdict(weak[-1].words).split(";")[0]
        unexcited = sum(not np.isfinite(d.variance) for d in weak)
        answer = (
            f"The {plural(len(weak), 'direction')} not identified yet, above all "
            f"{uncapitalized(worst)}"
        )
        answer += f"; the recording does not excite {unexcited} of them at all" if unexcited else ""
        answer += "."
    else:
        answer = (
            "Nothing in particular: every direction is identified; another motion is needed only "
            "to validate the model."
        )
    data = {
        "command": next_design_command(identification),
        "weak": _weak_parts(identification, weak) if weak else [],
    }
    return Section("next", "What should the next trajectory identify?", answer, data)


def _weak_parts(identification: Identification, weak: Sequence[Direction]) -> list[str]:
    """For each link and joint the number of weak directions that it dominates, and the worst."""
    parameters = identification.model.parameters
    owners = dict(zip(parameters.names, parameters.owners(), strict=True))
    groups: dict[str, list[Direction]] = {}
    for direction in weak:
        shares: dict[str, float] = {}
        for name, weight in direction.weights.items():
            shares[owners[name]] = shares.get(owners[name], 0.0) + weight
        groups.setdefault(max(shares, key=lambda owner: shares[owner]), []).append(direction)
    return [
        f"{owner}: {plural(len(group), 'direction')}, the worst "
        f"{uncapitalized(without_verdict(group[-1].words))}"
        for owner, group in sorted(groups.items(), key=lambda entry: -len(entry[1]))
    ]


# -- provenance ------------------------------------------------------------------------------------


def _provenance_section(identification: Identification, remarks: RemarksByRecording) -> Section:
    """Method, options, data and versions."""
    robot, options = identification.model.robot, identification.options
    method = _METHODS[options.method.value]
    count = plural(len(identification.fits), "recording")
    answer = (
        f"By {method}, then by the physically consistent robot that is nearest to data and prior "
        f"together, from {count}; {count_remarks(remarks)}."
    )
    segments = plural(len(identification.equations.starts), "segment")
    drive = [kind.replace("_", " ") for kind in identification.model.parameters.drive]
    gamma = f"{number(identification.gamma[0])}, {number(identification.gamma[1])}"
    accuracy = percent(float(np.sqrt(options.threshold)))
    requested = "" if options.band is None else ", as requested"
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "fitted to": ", ".join(p.source for p in identification.fits),
        "held out": ", ".join(p.source for p in identification.validations) or "nothing",
        "equations": f"{len(identification.equations)} × {robot.n} in {segments}"
        f"{_averaged(identification)}",
        "parameters": ", ".join(["inertial", *drive]),
        "band": f"{number(identification.spectra.hertz)} Hz{requested}",
        "estimator": method,
        "distance from the nominal robot": _DISTANCES[options.distance.value],
        "γ of links, of joint drives": f"{gamma} ({_gamma_source(identification)})",
        "log-likelihood lost to consistency and prior": number(identification.posterior.misfit, 3),
        "squared distance from the nominal robot": number(identification.posterior.distance, 3),
        "threshold of identified": f"variance {number(options.threshold)}, ±{accuracy}",
        "bounds": _bounds(identification),
        "delay": "removed (--align)" if options.align else "left as recorded",
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    trials = [(number(gamma, 2), number(error, 4)) for gamma, error in identification.gamma_trials]
    data = {
        "facts": Table(("quantity", "value"), list(facts.items())),
        "remarks": list_remarks(remarks),
        "trials": Table(("γ of links", "squared error"), trials, (0, 1)) if trials else None,
    }
    return Section("made", "How was it made?", answer, data)


def _averaged(identification: Identification) -> str:
    """Number of periods that were averaged."""
    periods = [p for p in identification.equations.periods if p]
    return f", the mean of {' and '.join(map(str, periods))} periods" if periods else ""


def _gamma_source(identification: Identification) -> str:
    """How the weight of the prior was chosen."""
    if identification.options.trusted:
        return f"{plural(len(identification.options.trusted), 'value')} fixed by --prior"
    gamma = identification.options.gamma
    if not isinstance(gamma, str):
        return "as given"
    return {"evidence": "by evidence", "heldout": "by cross-validation"}[gamma]


def _bounds(identification: Identification) -> str:
    """Bounds on masses and centres of mass."""
    bounds = identification.options.bounds
    masses = [f"mass of {link} {low:g} to {high:g} kg" for link, (low, high) in bounds.mass.items()]
    centres = [f"centre of mass of {link} in its box" for link in bounds.centre]
    return ", ".join([*masses, *centres]) or "none"

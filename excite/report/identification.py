"""The report of an identification: does the model hold, what changed, who decided it, and what to record next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

import numpy as np

from ..designer.identifiability import Direction
from ..identification import consistency
from ..identification.identification import Identification
from ..recordings import Remark
from ..robot.inertial_parameters import DRIVE
from ..robot.parameter_names import percent
from ..trajectory.trajectory_file import package_versions
from . import estimates, noise, prediction
from . import remarks as remarked
from .identifiability import without_verdict as bare
from .page import (
    Section,
    banner,
    bullets,
    cards,
    escape,
    folded,
    number,
    page,
    paragraph,
    plural,
    table,
)

_GRAVITY = (0.0, 0.0, -9.81)
_METHODS = {
    "ols": "least squares, all rows alike",
    "wls": "least squares, weighted by each joint's noise",
    "full": "least squares, weighted by the noise's covariance over the joints",
    "huber": "robust (Huber), weighted by each joint's noise",
    "iv": "instrumental variables, weighted by each joint's noise",
}
_DISTANCES = {
    "riemannian": "affine-invariant Riemannian",
    "bregman": "log-determinant Bregman divergence",
    "pullback": "the metric at the nominal robot (quadratic)",
    "euclidean": "Euclidean, in SI units",
}


def identification_page(
    found: Identification,
    remarks: Sequence[Remark] = (),
    *,
    stated: Mapping[str, str] | None = None,
) -> str:
    """The report of `excite identify` as HTML.

    remarks: what the health check of the recordings found. stated: further facts to show, name -> text.
    """
    robot = found.model.robot
    sections = [
        prediction.section(found),
        estimates.parameters_section(found),
        estimates.directions_section(found),
        estimates.bodies_section(found),
        noise.section(found),
        next_section(found),
        made_section(found, remarks, stated or {}),
    ]
    lede = "From recordings to physically consistent parameters: what they predict, how sure they are, and what is still missing."
    return page(
        f"Identification of {robot.name}",
        lede,
        _head(found),
        sections,
        f"excite {package_versions()['excite']}",
    )


def _head(found: Identification) -> str:
    robot, shown = found.model.robot, found.validations or found.fits
    worst = max(float(one.relative().max()) for one in shown)
    entries = [
        (str(robot.n), "moving joint" if robot.n == 1 else "moving joints"),
        (
            f"{found.analysis.identifiable_count} of {found.model.base.count}",
            "directions identified",
        ),
        (
            percent(worst),
            f"error over RMS torque, worst joint, {'held out' if found.validations else 'of the fit'}",
        ),
        (
            f"{len(found.equations)} × {robot.n}",
            f"equations below {number(found.spectra.hertz, 3)}\u00a0Hz",
        ),
        (
            f"{number(found.gamma[0], 2)}, {number(found.gamma[1], 2)}",
            "weight γ of the prior: bodies, drives",
        ),
    ]
    if consistency.is_consistent(found.model.parameters, found.psi):
        verdict = banner(
            "Every link is a body that could be built; friction and rotor inertia are not negative.",
            "good",
        )
    else:
        verdict = banner(
            "These parameters are NOT physically consistent: do not simulate or control with them.",
            "bad",
        )
    if found.model.parameters.repaired:
        text = f"No proper body in the URDF: {', '.join(found.model.parameters.repaired)}. A small substitute stands for it in the prior."
        verdict += banner(text, "warn")
    return cards(entries) + verdict


# -- what next -----------------------------------------------------------------------------------------------


def command(found: Identification) -> str:
    """The shell command that designs a motion for what these recordings leave open."""
    robot, drive = found.model.robot, found.model.parameters.drive
    words = ["excite", "design", robot.source]
    for one in found.fits:
        words += ["--given", one.source]
    locked = robot.options.get("locked")
    if isinstance(locked, Mapping) and locked:
        words += ["--joints", ",".join(robot.joints)]
        for name, value in locked.items():
            words += ["--lock", f"{name}={value:.9g}"]
    gravity = robot.options.get("gravity")
    if isinstance(gravity, list) and not np.allclose(gravity, _GRAVITY):
        words += [f"--gravity={','.join(f'{v:.9g}' for v in gravity)}"]
    payload = robot.options.get("payload")
    if isinstance(payload, Mapping):
        numbers = (payload["mass"], *payload["centre"], *payload["inertia"])
        words += ["--payload", f"{payload['link']}:{','.join(f'{v:.9g}' for v in numbers)}"]
    missing = [kind for kind in DRIVE if kind not in drive]
    if len(missing) == len(DRIVE):
        words += ["--parameters", "inertial"]
    elif missing:
        words += ["--without", ",".join(missing)]
    return shlex.join([*words, "--validation", "-o", "next"])


def next_section(found: Identification) -> Section:
    """What should the next trajectory ask for?"""
    weak = [d for d in found.analysis.directions if not d.identifiable]
    if weak:
        what = bare(weak[-1].words).split(";")[0]
        hidden = sum(not np.isfinite(d.variance) for d in weak)
        answer = (
            f"The {plural(len(weak), 'direction')} not identified yet, above all {uncapital(what)}"
        )
        answer += f"; {hidden} of them it does not excite at all." if hidden else "."
    else:
        answer = "Nothing in particular: every direction is identified; another motion is needed only to judge the model by."
    body = paragraph(
        "The command adds to what is already known and adds a second motion to validate with:"
    )
    body += f"<p><code>{escape(command(found))}</code></p>"
    body += paragraph(
        "Give --limits, --torque-noise and --box again if they were given before.", "note"
    )
    if weak:
        body += "<h3>Where they lie, most of them first</h3>" + bullets(_whose(found, weak))
    return Section("next", "What should the next trajectory ask for?", answer, body)


def _whose(found: Identification, weak: Sequence[Direction]) -> list[str]:
    """A line for each link and joint that weak directions are mostly about: how many, and the worst."""
    owners = dict(zip(found.model.parameters.names, found.model.parameters.owners(), strict=True))
    groups: dict[str, list[Direction]] = {}
    for direction in weak:
        shares: dict[str, float] = {}
        for name, weight in direction.weights.items():
            shares[owners[name]] = shares.get(owners[name], 0.0) + weight
        groups.setdefault(max(shares, key=lambda owner: shares[owner]), []).append(direction)
    return [
        f"{owner}: {plural(len(group), 'direction')}, the worst {uncapital(bare(group[-1].words))}"
        for owner, group in sorted(groups.items(), key=lambda item: -len(item[1]))
    ]


def uncapital(text: str) -> str:
    """With a small first letter, to stand inside a sentence."""
    return text[:1].lower() + text[1:]


# -- how -----------------------------------------------------------------------------------------------------


def made_section(
    found: Identification, remarks: Sequence[Remark], stated: Mapping[str, str]
) -> Section:
    """How was it made?"""
    robot, options = found.model.robot, found.options
    answer = f"By {_METHODS[options.method.value]}, then the consistent robot nearest to data and prior at once, "
    answer += f"from {plural(len(found.fits), 'recording')}"
    answer += f"; {remarked.said(remarks)}."
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.sha256,
        "fitted to": ", ".join(one.source for one in found.fits),
        "held out": ", ".join(one.source for one in found.validations) or "nothing",
        "rows": f"{len(found.equations)} × {robot.n} equations in {plural(len(found.equations.starts), 'part')}{_averaged(found)}",
        "parameters": "inertial"
        + "".join(f", {kind.replace('_', ' ')}" for kind in found.model.parameters.drive),
        "band": f"{number(found.spectra.hertz)} Hz"
        + ("" if options.band is None else ", as asked for"),
        "estimator": _METHODS[options.method.value],
        "kind of distance": _DISTANCES[options.distance.value],
        "γ of bodies, of drives": f"{number(found.gamma[0])}, {number(found.gamma[1])} ({_chosen(found)})",
        "what consistency and prior cost": f"{number(found.posterior.misfit, 3)} in log-likelihood",
        "distance² from the nominal robot": number(found.posterior.distance, 3),
        "threshold of identified": f"variance {number(options.threshold)}, ±{percent(float(np.sqrt(options.threshold)))}",
        "bounds": _bounds(found),
        "delay": "removed (--align)" if options.align else "left as recorded",
        **stated,
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    body = table(("what", "value"), [(escape(k), escape(v)) for k, v in facts.items()])
    body += remarked.listed(remarks)
    if found.gamma_trials:
        rows = [(number(g, 2), number(error, 4)) for g, error in found.gamma_trials]
        body += folded(
            "Every γ that was tried, with its squared error on blocks left out",
            table(("γ of bodies", "error"), rows, (0, 1)),
        )
    return Section("made", "How was it made?", answer, body)


def _averaged(found: Identification) -> str:
    periods = [p for p in found.equations.periods if p]
    return f", the mean of {' and '.join(map(str, periods))} periods" if periods else ""


def _chosen(found: Identification) -> str:
    if found.options.trusted:
        return f"{plural(len(found.options.trusted), 'value')} held fast by --prior"
    gamma = found.options.gamma
    return (
        {"evidence": "by evidence", "heldout": "by blocks left out"}[gamma]
        if isinstance(gamma, str)
        else "as given"
    )


def _bounds(found: Identification) -> str:
    bounds = found.options.bounds
    parts = [f"mass of {link} {low:g} to {high:g} kg" for link, (low, high) in bounds.mass.items()]
    return (
        ", ".join([*parts, *(f"centre of {link} in its box" for link in bounds.centre)]) or "none"
    )

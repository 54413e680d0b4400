"""Report of a floating-base identification: prediction, bodies, rows and directions."""

from __future__ import annotations

from pathlib import Path

from markupsafe import Markup

from .._types import FloatArray
from ..identification import consistency
from ..identification.floating_identification import FloatingIdentification
from ..identification.identification import Prediction
from ..identification.link_estimates import DECIDED_SHARE
from ..robot.floating_base import WRENCH
from ..robot.parameter_names import percent, plural
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table, TableCell
from .figures.torque_fit import draw_fit, points_per_curve
from .formatting import number
from .identifiability import without_verdict
from .remarks import RemarksByRecording, count_remarks, list_remarks
from .render import render

LISTED_DIRECTIONS = 12
"""Directions that are listed."""


def floating_identification_page(
    identification: FloatingIdentification, remarks: RemarksByRecording | None = None
) -> str:
    """Render the report of `excite identify --floating` as HTML.

    Args:
        identification: The result.
        remarks: Remarks of the data-quality checks, by recording.
    """
    remarks = remarks or {}
    model = identification.model
    content = ReportContent(
        title=f"Identification of {model.robot.name} with a floating base",
        subtitle="Physically consistent bodies from contact wrenches and joint torques: how well "
        "they predict, and which of them the recordings decide.",
        banners=_banners(identification),
        cards=_cards(identification),
        sections=[
            _prediction_section(identification),
            _bodies_section(identification),
            _directions_section(identification),
            _rows_section(identification),
            _provenance_section(identification, remarks),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("summary", content)


def _shown(identification: FloatingIdentification) -> tuple[Prediction, ...]:
    """Validation recordings, or the fitted ones without."""
    return identification.validations or identification.fits


def _banners(identification: FloatingIdentification) -> list[Banner]:
    """Verdicts on prediction and physical consistency."""
    banners = []
    if identification.validations:
        better = sum(
            int((p.error() < p.error("nominal")).sum()) for p in identification.validations
        )
        total = sum(p.measured.shape[1] for p in identification.validations)
        tone = "good" if better == total else "warn" if better >= total / 2 else "bad"
        text = f"On held-out recordings {better} of {total} rows are predicted better than before."
        banners.append(Banner(text, tone))
    else:
        text = "Nothing is held out: the errors below are those of the fit. Give --validate."
        banners.append(Banner(text, "warn"))
    if consistency.is_consistent(identification.model.parameters, identification.psi):
        banners.append(Banner("All bodies are physically consistent.", "good"))
    else:
        banners.append(Banner("These bodies are NOT physically consistent.", "bad"))
    repaired = identification.model.parameters.repaired
    if repaired:
        text = (
            f"The inertia of {', '.join(repaired)} in the URDF is not physically consistent; the "
            "prior uses a small substitute."
        )
        banners.append(Banner(text, "warn"))
    return banners


def _cards(identification: FloatingIdentification) -> list[tuple[str, str]]:
    """Key figures."""
    shares = identification.body_shares()
    decided = sum(share >= DECIDED_SHARE for share in shares.values())
    analysis = identification.analysis
    mass = sum(link.mass for link in identification.links())
    return [
        (f"{decided} of {len(shares)}", "bodies of which the data decide at least half"),
        (
            f"{analysis.identifiable_count} of {identification.model.base.count}",
            "directions identified",
        ),
        (f"{number(mass)} kg", "mass of all bodies"),
        (number(identification.prior.inertial_weight, 3), "weight γ of the prior"),
    ]


def _prediction_section(identification: FloatingIdentification) -> Section:
    """Errors of each row before and after, and curves."""
    model, predictions = identification.model, _shown(identification)
    tables, figures = [], []
    points = points_per_curve(predictions, len(model.joints))
    for prediction in predictions:
        rows = [
            (
                name,
                number(float(signal), 3),
                number(float(before), 3),
                TableCell(number(float(after), 3), bold=True),
                unit,
            )
            for name, signal, before, after, unit in zip(
                model.joints,
                prediction.measured.std(axis=0),
                prediction.error("nominal"),
                prediction.error(),
                model.row_units(),
                strict=True,
            )
        ]
        head = ("row", "signal (std)", "error, nominal bodies", "error, identified", "unit")
        tables.append(Table(head, rows, (1, 2, 3)))
        title = f"Measured and predicted rows of {prediction.source}"
        figures.append(Markup(draw_fit(prediction, model.joints, model.row_units(), title, points)))
    answer = (
        ("Held-out recordings" if identification.validations else "Recordings of the fit")
        + ": RMS error of each row below its cutoff frequency. Rows of the wrench are in the axes "
        "of the world about the origin of the base link."
    )
    names = [Path(prediction.source).name for prediction in predictions]
    return Section(
        "prediction",
        "Does the model predict the wrench?",
        answer,
        {"figures": figures, "tables": tables, "notes": names},
    )


def _bodies_section(identification: FloatingIdentification) -> Section:
    """Share of each body that the data decide, mass and centre of mass."""
    shares = identification.body_shares()
    parameters = identification.model.parameters
    nominal = consistency.inertial_rows(parameters, identification.prior.nominal)
    rows = [
        (
            link.name,
            TableCell(percent(shares[link.name]), share=shares[link.name]),
            TableCell(
                number(link.mass),
                after=f"± {number(link.mass_deviation, 2)}",
                note=f"nominal {number(float(phi[0]))}",
            ),
            percent(link.mass_share),
            TableCell(_millimetres(link.centre), note=f"nominal {_millimetres(phi[1:4] / phi[0])}"),
        )
        for link, phi in zip(identification.links(), nominal, strict=True)
    ]
    head = ("body", "decided by the data", "mass [kg]", "mass decided", "centre of mass [mm]")
    ordered = sorted(shares, key=lambda link: -shares[link])
    leading = [f"{link} ({percent(shares[link])})" for link in ordered[:3]]
    symmetric = identification.options.symmetric
    answer = f"Most of {', '.join(leading)}; the prior decides the rest of each body."
    if symmetric is not None:
        answer += f" Bodies {symmetric[0]}… and {symmetric[1]}… are taken to mirror each other."
    return Section(
        "bodies",
        "With which bodies do the data decide?",
        answer,
        {"tables": [Table(head, rows, (2, 3))]},
    )


def _millimetres(point: FloatArray) -> str:
    """Return a point as text [mm]."""
    return ", ".join(number(float(round(1e3 * float(value)))) for value in point)


def _directions_section(identification: FloatingIdentification) -> Section:
    """The best and worst directions in words."""
    analysis = identification.analysis
    rows = [
        (
            number(direction.variance, 2),
            TableCell("identified", tone="good")
            if direction.identifiable
            else TableCell("not identified", tone="warn"),
            without_verdict(direction.words),
        )
        for direction in analysis.directions[:LISTED_DIRECTIONS]
    ]
    answer = (
        f"{analysis.identifiable_count} of {identification.model.base.count} directions have a "
        f"scale-free variance of at most {number(analysis.threshold)}, from independent samples."
    )
    return Section(
        "directions",
        "Which combinations are identified?",
        answer,
        {"tables": [Table(("variance", "", "direction"), rows, (0,))]},
    )


def _rows_section(identification: FloatingIdentification) -> Section:
    """Weight and band of each row, and offsets of the sensors."""
    model, weights = identification.model, identification.weights
    rows = [
        (
            name,
            number(float(deviation), 3),
            number(float(samples), 3),
            number(float(hertz), 3),
            unit,
        )
        for name, deviation, samples, hertz, unit in zip(
            model.joints,
            weights.deviation,
            weights.samples_per_independent,
            identification.hertz,
            model.row_units(),
            strict=True,
        )
    ]
    head = ("row", "residual", "samples per independent sample", "cutoff [Hz]", "unit")
    tables = [Table(head, rows, (1, 2, 3))]
    if len(identification.offset):
        offsets = identification.offset.reshape(-1, 6)
        deviations = identification.offset_deviation.reshape(-1, 6)
        cells = [
            (frame, *(f"{number(float(b), 3)} ± {number(float(s), 2)}" for b, s in pairs))
            for frame, pairs in zip(
                model.contacts,
                (list(zip(b, s, strict=True)) for b, s in zip(offsets, deviations, strict=True)),
                strict=True,
            )
        ]
        tables.append(Table(("offset of the sensor at", *WRENCH), cells, (1, 2, 3, 4, 5, 6)))
    answer = (
        "Every row is weighted by the variance of its residual times the number of samples that "
        "are worth an independent one; with its cutoff frequency "
        "the predicted row has the smallest error on the recordings of the fit."
    )
    return Section("rows", "How were the rows weighted?", answer, {"tables": tables})


def _provenance_section(
    identification: FloatingIdentification, remarks: RemarksByRecording
) -> Section:
    """Options, data and versions."""
    model, options = identification.model, identification.options
    robot = model.robot
    contacts = ", ".join(model.contacts) or "none"
    facts = {
        "robot": f"{robot.name} ({robot.source})",
        "SHA-256 of the URDF": robot.joint_robot.sha256,
        "fitted to": ", ".join(p.source for p in identification.fits),
        "held out": ", ".join(p.source for p in identification.validations) or "nothing",
        "rows": f"{model.rows.value}: {identification.rows_fitted} × {len(model.joints)}",
        "contacts": contacts,
        "joint parameters": ", ".join(model.parameters.drive) or "none",
        "distance from the nominal robot": options.distance.value,
        "γ": f"{number(identification.prior.inertial_weight, 3)} "
        + ("as given" if not isinstance(options.gamma, str) else f"by {options.gamma}"),
        "squared distance from the nominal robot": number(identification.posterior.distance, 3),
        "versions": ", ".join(f"{k} {v}" for k, v in package_versions().items()),
    }
    tables = [Table(("quantity", "value"), list(facts.items()))]
    trials = [(number(g, 3), number(error, 4)) for g, error in identification.gamma_trials]
    if trials:
        tables.append(Table(("γ", "squared error on parts left out"), trials, (0, 1)))
    answer = (
        f"From {plural(len(identification.fits), 'recording')}, by weighted least squares and the "
        f"physically consistent robot nearest to data and prior together; {count_remarks(remarks)}."
    )
    if remarked := list_remarks(remarks):
        tables.append(remarked["table"])
    return Section("made", "How was it made?", answer, {"tables": tables})

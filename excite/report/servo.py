"""Report of an identification without torque: positions, parameters, and position loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup

from ..identification.identified_model import JOINT_PARAMETER_UNITS
from ..identification.link_estimates import link_estimates
from ..identification.servo_identification import PositionReplay, ServoIdentification
from ..trajectory.trajectory_file import package_versions
from .content import Banner, ReportContent, Section, Table
from .formatting import number
from .render import render
from .replay import draw_replay


def servo_page(identification: ServoIdentification) -> str:
    """Render the report as HTML.

    Args:
        identification: The result.
    """
    replays = identification.validations or identification.fits
    where = "held out" if identification.validations else "in the recordings fitted"
    error, tracking = (
        float(np.sqrt(np.mean([replay.error(key) ** 2 for replay in replays])))
        for key in ("fitted", "command")
    )
    verdict = (
        f"Simulated positions differ from the recorded ones by {number(error, 3)} {where} (RMS, "
        f"rad or m); the commanded positions by {number(tracking, 3)}."
    )
    content = ReportContent(
        title=f"Identification of {identification.model.robot.name} without torque",
        subtitle="Links, joint parameters and position loops from commanded and measured "
        "positions.",
        banners=[
            Banner(verdict, "good" if error < tracking else "warn"),
            Banner(_capitalized(identification.scale_statement) + ".", "warn"),
        ],
        cards=[
            (number(error, 3), f"position error, {where} [rad or m]"),
            (number(tracking, 3), "commanded minus recorded position [rad or m]"),
        ],
        sections=[
            _position_section(identification),
            _loop_section(identification),
            _joint_section(identification),
            _link_section(identification),
        ],
        footer=f"excite {package_versions()['excite']}",
    )
    return render("summary", content)


def _capitalized(text: str) -> str:
    return text[:1].upper() + text[1:]


def _position_section(identification: ServoIdentification) -> Section:
    """Free runs along complete recordings."""
    joints, rows = identification.model.robot.joints, []
    for use, replays in (
        ("held out", identification.validations),
        ("fitted", identification.fits),
    ):
        for replay in replays:
            errors = replay.error(), replay.error("command")
            for j, joint in enumerate(joints):
                values = (number(float(e[j]), 3) for e in errors)
                rows.append((Path(replay.source).name, use, joint, *values))
    head = ("recording", "use", "joint", "simulated", "commanded")
    drawn: PositionReplay = (identification.validations or identification.fits)[0]
    figure = draw_replay(
        joints,
        drawn.time,
        drawn.measured,
        ("commanded", drawn.command),
        ("simulated", drawn.fitted),
    )
    return Section(
        "positions",
        "How far do simulated positions deviate?",
        "RMS of simulated, and of commanded, minus recorded position [rad or m], each recording "
        "simulated from its first state to its end under its commands.",
        {"figures": [Markup(figure)], "tables": [Table(head, rows, (3, 4))]},
    )


def _loop_section(identification: ServoIdentification) -> Section:
    """The position loops."""
    loop, rows = identification.loop, []
    for j, joint in enumerate(identification.model.robot.joints):
        std = identification.loop_deviation[:, j]
        values = (loop.proportional[j], loop.derivative[j], 1e3 * loop.delay[j])
        spread = (std[0], std[1], 1e3 * std[2])
        cells = [
            number(float(v), 4) + (f" ± {number(float(s), 2)}" if s else "")
            for v, s in zip(values, spread, strict=True)
        ]
        rows.append((joint, *cells))
    return Section(
        "loop",
        "Which position loop do the servos have?",
        identification.scale_statement,
        {"tables": [Table(("joint", "Kp [N m/rad]", "Kd [N m s/rad]", "delay [ms]"), rows)]},
    )


def _joint_section(identification: ServoIdentification) -> Section:
    """Joint parameters, and their ratios to K_p."""
    parameters, rows = identification.model.parameters, []
    deviation = np.sqrt(np.maximum(np.diag(identification.posterior.covariance), 0.0))
    for k, kind in enumerate(parameters.drive):
        block = parameters.block(kind)
        for j, joint in enumerate(parameters.joints):
            value, std = identification.psi[block][j], deviation[block][j]
            ratio = value / identification.loop.proportional[j]
            unit = identification.model.robot.entries[j].unit(JOINT_PARAMETER_UNITS[kind])
            name = kind.replace("_", " ")
            spread = float(identification.ratio_deviation[k, j])
            cells = (
                number(float(value), 3),
                number(float(std), 2),
                f"{number(float(ratio), 3)} ± {number(spread, 2)}",
            )
            rows.append((joint, name, *cells, unit))
    head = ("joint", "parameter", "value", "std", "value / Kp", "unit")
    return Section(
        "joints",
        "Which friction and rotor inertia do the joints have?",
        "Values in the scale that is stated above, and their ratio to the servo gain.",
        {"tables": [Table(head, rows, (2, 3, 4))]},
    )


def _link_section(identification: ServoIdentification) -> Section:
    """Masses of the links."""
    rows = [
        (
            link.name,
            f"{number(link.mass, 4)} ± {number(link.mass_deviation, 2)}",
            f"{100.0 * link.mass_share:.0f} %",
        )
        for link in link_estimates(
            identification.model.parameters, identification.posterior, identification.prior
        )
    ]
    return Section(
        "links",
        "Which masses do the links have?",
        "In the same scale; the share of each mass that the recordings decide.",
        {"tables": [Table(("link", "mass [kg]", "data"), rows)]},
    )

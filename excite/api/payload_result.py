"""Identify a payload: the body attached to a link, from recordings with and without it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .. import _json
from .._system.one_or_several import one_or_several
from .._system.progress import logger
from ..errors import ExciteWarning, UnusableInput
from ..identification import segments
from ..identification.identified_model import IdentifiedModel, read_content, read_model
from ..identification.regression import IdentificationModel
from ..payload.equations import build_payload_equations, payload_place
from ..payload.estimate import PayloadEstimate, estimate_payload, require_mass
from ..payload.shape import PayloadShape, parse_shape
from ..payload.snippets import snippets
from ..payload.static import estimate_static_payload, find_rests
from ..recordings import Recording, require_distinct
from ..recordings.periodicity import with_detected_period
from ..robot import base_parameters, inertial_parameters
from ..robot.inertial_parameters import COULOMB_WIDTH
from ..robot.limits import Limits
from ..robot.robot import Robot
from ..trajectory.trajectory_file import read_trajectory
from .identification_result import (
    RecordingSource,
    RecordingSources,
    TrajectorySources,
    read_recording,
    recording_doubts,
    robot_of_torque,
    with_torque_doubts,
    with_trajectory,
)
from .input_files import argument_files
from .robots import RobotSource, load_robot, resolve_limits
from .saved_result import SavedResult
from .stated_recordings import stated_columns

PAYLOAD_FILES = ("payload.json", "report.html")
"""Files of a payload."""
DIFFERENT_MOUNTING = 0.01
"""p-value below which recordings hold differently mounted payloads."""


@dataclass(frozen=True)
class PayloadResult(SavedResult):
    """A payload with its uncertainty.

    Attributes:
        robot: The robot.
        link: Link whose frame the values are in.
        estimate: The payload.
        shape: Its stated shape; None: none was stated.
        mass: Its stated mass [kg]; None: none was stated.
        carrying: Recordings with the payload, one or several.
        empty: Recordings without.
        hertz: Cutoff frequency of the fit; None: static poses [Hz].
        rests: Number of rests with and without the payload; None: a motion.
    """

    FILES = PAYLOAD_FILES

    robot: Robot
    link: str
    estimate: PayloadEstimate
    shape: PayloadShape | None
    mass: float | None
    carrying: tuple[Recording, ...]
    empty: tuple[Recording, ...]
    hertz: float | None
    rests: tuple[int, int] | None = None

    @property
    def mounting(self) -> str | None:
        """How the payload was mounted in the recordings with it: "same" or "different" in all of
        them; None for one recording."""
        p_value = self.estimate.mounting
        if p_value is None:
            return None
        return "different" if p_value < DIFFERENT_MOUNTING else "same"

    @property
    def other_mass(self) -> tuple[float, float] | None:
        """Mass that the torque alone shows, and its standard deviation [kg]; None unless it clearly
        differs from the stated mass."""
        data = self.estimate.data
        if self.mass is None or not data.contradicts(self.mass):
            return None
        return float(data.theta[0]), data.mass_deviation

    @property
    def doubts(self) -> list[dict[str, Any]]:
        """Unrepaired doubts about the recordings, with the recording that each is about."""
        return recording_doubts([*self.carrying, *self.empty])

    def document(self) -> dict[str, Any]:
        """Return the content of `payload.json`."""
        estimate = self.estimate
        return {
            "schema": "excite.payload/1",
            "robot": {"name": self.robot.name, "source": self.robot.source},
            "link": self.link,
            "with": [recording.source for recording in self.carrying],
            "without": [recording.source for recording in self.empty],
            "shape": None if self.shape is None else self.shape.description,
            "stated_mass": self.mass,
            "mass_by_torque": None
            if self.other_mass is None
            else dict(zip(("value", "std"), self.other_mass, strict=True)),
            "payload": {q.name: q.document() for q in estimate.quantities},
            "not_shown": [q.name for q in estimate.quantities if not q.shown],
            "static": None
            if self.rests is None
            else {"rests_with": self.rests[0], "rests_without": self.rests[1]},
            "load_friction": None
            if estimate.load_friction is None
            else dict(zip(self.robot.joints, estimate.load_friction.tolist(), strict=True)),
            "mounting": None
            if estimate.mounting is None
            else {"verdict": self.mounting, "p_value": estimate.mounting},
            "residual": dict(zip(self.robot.joints, estimate.residual.tolist(), strict=True)),
            "band_hz": self.hertz,
            "snippets": snippets(estimate.body, self.link),
            **({"doubts": self.doubts} if self.doubts else {}),
        }

    def html(self) -> str:
        """Return the report as HTML."""
        from ..report.payload import payload_page

        return payload_page(self.document())

    def contents(self) -> dict[str, str]:
        """Return the files of the payload by name."""
        return {"payload.json": _json.dumps(self.document()), "report.html": self.html()}

    def __repr__(self) -> str:
        mass = self.estimate["mass"]
        return f"<PayloadResult at {self.link}: {mass.value:.4g} ± {mass.std:.2g} kg>"


def identify_payload(
    robot: RobotSource,
    carrying: RecordingSources,
    *,
    empty: RecordingSources = (),
    model: str | Path | None = None,
    link: str | None = None,
    mass: float | None = None,
    shape: str | None = None,
    limits: str | Path | Limits | None = None,
    band: float | None = None,
    trajectory: TrajectorySources = (),
    columns: Mapping[str, str] = MappingProxyType({}),
    static: bool = False,
) -> PayloadResult:
    """Identify a payload, as `excite payload` does.

    Args:
        robot: Path of a URDF, name of a built-in model, or a loaded robot, without the payload.
        carrying: Recordings with the payload, one or several.
        empty: Recordings without.
        model: `model.json` of the robot without the payload, whose recordings are used.
        link: Link whose frame the values are in; None: the last one.
        mass: Mass of the payload, if it was weighed [kg].
        shape: Its shape, see `payload.shape.USAGE`.
        limits: Limits file or limits.
        band: Cutoff frequency [Hz]; None: chosen from the data.
        trajectory: The `trajectory.json` that was executed, or several; static poses imply
            `static`.
        columns: Standard names of columns (`t`, `q.<joint>`, …) -> differing names in a CSV file;
            those of the recordings of a model are stated in it.
        static: Use only the poses at rest, which show mass and centre of mass. With a model, its
            prediction is then the torque without the payload.

    Raises:
        UnusableInput: An argument or a file cannot be used.
    """
    carrying, empty = one_or_several(carrying), one_or_several(empty)
    loaded = load_robot(robot)
    table = resolve_limits(loaded, limits)
    link = loaded.links[-1] if link is None else link
    place = payload_place(loaded, link)
    stated = None if shape is None else parse_shape(shape)
    if mass is not None and not 0.0 < mass < 1e5:
        raise UnusableInput(f"--mass {mass:g}: should be a mass above 0 [kg]")
    if not carrying:
        raise UnusableInput("--with: needs a recording with the payload")
    if not empty and model is None:
        raise UnusableInput(
            "--without: needs a recording without the payload on the same robot, or a --model of it"
        )
    static = static or any(
        "static" in read_trajectory(Path(file)).design for file in one_or_several(trajectory)
    )
    of_model = [] if model is None or static else _recordings_of(Path(model))
    inputs = argument_files(
        *(loaded.source, model, limits, trajectory),
        recordings=(*carrying, *empty, *(path for path, _ in of_model)),
        shape=shape,
    )

    def read(
        paths: Sequence[RecordingSource],
        has_payload: bool,
        with_names: Sequence[tuple[Path, Mapping[str, str]]] = (),
    ) -> list[Recording]:
        recordings = [
            read_recording(path, loaded, limits=table, columns=names)
            for path, names in [*((path, columns) for path in paths), *with_names]
        ]
        if not static:  # the rests are found in the recording
            recordings = [with_trajectory(r, trajectory, required=False) for r in recordings]
        recordings = [
            with_torque_doubts(recording, loaded, table, has_payload=has_payload)
            for recording in recordings
        ]
        return recordings if static else [with_detected_period(r) for r in recordings]

    logger.info(
        f"reading {len(carrying)} recordings with and {len(empty) + len(of_model)} without the "
        "payload"
    )
    loaded_recordings, empty_recordings = read(carrying, True), read(empty, False, of_model)
    for group in (loaded_recordings, empty_recordings):
        require_distinct(group, ())
    both = {r.source for r in loaded_recordings} & {r.source for r in empty_recordings}
    if both:
        raise UnusableInput(f"{min(both)}: is both with and without the payload; name it once")
    loaded = robot_of_torque(loaded, [*loaded_recordings, *empty_recordings])
    standard = inertial_parameters.standard_parameters(loaded, table)
    base = base_parameters.find(loaded, standard, table)
    identification = IdentificationModel(loaded, standard, base, np.full(loaded.n, COULOMB_WIDTH))
    if static:
        rests = [find_rests(recording) for recording in loaded_recordings]
        without = [find_rests(recording) for recording in empty_recordings]
        identified = None if model is None else _model_of(Path(model), loaded)
        if identified is not None and identified.base_covariance is None:
            warnings.warn(
                f"{model}: states no covariance of its parameters, so that the intervals of the "
                "payload do not contain the uncertainty of the robot; identify it again",
                ExciteWarning,
                stacklevel=2,
            )
        logger.info(
            f"{sum(map(len, rests))} rests with and {sum(map(len, without))} without the payload"
        )
        result = estimate_static_payload(
            identification, place, rests, without, stated, mass, identified
        )
        require_mass(result, [recording.source for recording in loaded_recordings])
        return PayloadResult(
            loaded,
            link,
            result,
            stated,
            mass,
            tuple(loaded_recordings),
            tuple(empty_recordings),
            None,
            (sum(map(len, rests)), sum(map(len, without))),
            inputs=inputs,
        )
    groups = [list(segments.extract_segments([recording])) for recording in loaded_recordings]
    others = list(segments.extract_segments(empty_recordings))
    together = [segment for group in groups for segment in group]
    if not together or not others:
        raise UnusableInput(
            f"{(loaded_recordings if not together else empty_recordings)[0].source}: has no "
            "gap-free stretch that is long enough; record again"
        )
    hertz = segments.torque_spectra(together, band, others=others).hertz
    logger.info(f"band {hertz:.3g} Hz: building the equations")
    equations = build_payload_equations(identification, place, groups, others, hertz)
    result = estimate_payload(equations, stated, mass)
    require_mass(result, [recording.source for recording in loaded_recordings])
    return PayloadResult(
        loaded,
        link,
        result,
        stated,
        mass,
        tuple(loaded_recordings),
        tuple(empty_recordings),
        hertz,
        inputs=inputs,
    )


def _model_of(path: Path, robot: Robot) -> IdentifiedModel:
    """Read a model of the same joints.

    Raises:
        UnusableInput: The file is no model, or has other joints.
    """
    model = read_model(path)
    if model.robot.joints != robot.joints:
        raise UnusableInput(
            f"{path}: has the joints {', '.join(model.robot.joints)}, not "
            f"{', '.join(robot.joints)}; choose them with --joints"
        )
    return model


def _recordings_of(path: Path) -> list[tuple[Path, Mapping[str, str]]]:
    """Paths of the recordings that a model was fitted to, and the names of their columns.

    They are sought in the folder of the model first: another folder may hold other recordings of
    the same names.

    Raises:
        UnusableInput: The file is no model, or a recording is no longer in its place.
    """
    _, content = read_content(path)
    out = []
    for name in content.get("recordings", []):
        stated = Path(str(name))
        places = (path.parent / stated, path.parent / stated.name, stated)
        place = next((p for p in places if p.exists()), None)
        if place is None:
            raise UnusableInput(
                f"{path}: its recording {name} is not in its place; give the recordings without "
                "the payload with --without"
            )
        out.append((place, stated_columns(content, place)))
    return out

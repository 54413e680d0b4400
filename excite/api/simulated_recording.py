"""Record a simulated robot that follows a trajectory."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._system.one_or_several import one_or_several
from .._system.output_files import OutputFiles, output_files
from ..errors import UnusableInput
from ..robot import source_text, urdf, xml_file
from ..robot.limits import Limits
from ..robot.robot import locate
from ..schemas.document_file import DocumentFile
from ..schemas.truth import SCHEMA, TruthDocument
from ..trajectory import trajectory_file
from .input_files import argument_files
from .mujoco_extra import require_mujoco


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording of a simulated robot, with the ground truth.

    Attributes:
        recording: Measured positions and torques.
        truth: Content of the `.truth.json`: inertial and joint parameters, hidden effects and
            their severities.
        effects: The hidden effects.
        undisturbed: The same run without the hidden effects.
        severity: RMS of the effects' torque after a refit of the base model, over the noise RMS
            [1].
        severity_trusted: The same without a refit [1].
        units: Unit of the torque of each joint, "N m" or "N".
        inputs: Files that it was computed from, which `save` and `report` do not replace.
    """

    recording: Any
    truth: dict[str, Any]
    effects: tuple[Any, ...]
    undisturbed: Any
    severity: float
    severity_trusted: float
    units: Mapping[str, str]
    inputs: tuple[Path, ...] = field(default=(), repr=False)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(self.recording.joints)

    def contents(self, name: str) -> dict[str, str]:
        """Return the files of the recording: rows, sidecar, ground truth and plot.

        Args:
            name: Name of the CSV file.
        """
        from ..simulator import recording_file

        stem = name.removesuffix(".csv")
        return {
            name: self.recording.to_csv(),
            f"{stem}.json": recording_file.json_text(self.recording.to_sidecar()),
            f"{stem}.truth.json": recording_file.json_text(self.truth),
            f"{stem}.svg": self.picture(),
        }

    def picture(self) -> str:
        """Plot the torque with and without the hidden effects, as SVG."""
        from ..report.figures.simulation import torque_with_and_without_effects

        return torque_with_and_without_effects(
            self.recording, self.undisturbed, self.effects, self.units
        )

    def save(self, path: str | Path) -> list[Path]:
        """Write the CSV file, its sidecar, its ground truth and a plot; return their paths.

        Raises:
            UnusableInput: A file cannot be written, or is among `inputs`.
        """
        path = checked_path(path)
        return recording_files(path, self.inputs).replace(self.contents(path.name))

    def report(self, path: str | Path) -> Path:
        """Write the plot alone; return its path.

        Raises:
            UnusableInput: The file cannot be written.
        """
        path = Path(path)
        return output_files(path, inputs=self.inputs).replace({path.name: self.picture()})[0]

    def __repr__(self) -> str:
        hidden = ", ".join(effect.name for effect in self.effects) or "nothing hidden"
        return (
            f"<SimulatedRecording of {len(self.joints)} joints, "
            f"{len(self.recording.t)} rows: {hidden}>"
        )


def checked_path(path: str | Path) -> Path:
    """Return the path of a recording to be written.

    Raises:
        UnusableInput: Its name does not end in `.csv`.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise UnusableInput(
            f"-o {path}: should end in .csv; its sidecar, truth and plot take the same name"
        )
    return path


def recording_files(path: Path, inputs: Sequence[Path] = ()) -> OutputFiles:
    """Return the output files of a recording.

    Args:
        path: The CSV file.
        inputs: Files that must not be replaced.

    Raises:
        UnusableInput: A file cannot be written, or is one of the inputs.
    """
    siblings = (f"{path.stem}.json", f"{path.stem}.truth.json", f"{path.stem}.svg")
    return output_files(path, siblings, inputs)


def simulate(
    robot: str | Path,
    trajectory: str | Path,
    effects: str | Sequence[str] = (),
    *,
    dense: float | None = None,
    severity: float | None = None,
    trusted: bool = False,
    like: str | Path | None = None,
    periods: int | None = None,
    **setting: Any,
) -> SimulatedRecording:
    """Record a simulated robot whose physics differs from its model, as `excite simulate` does.

    Args:
        robot: Path of a URDF or name of a built-in model.
        trajectory: Path of a `trajectory.json`.
        effects: Hidden effect or effects, each as `NAME:JOINT[:k=v,…]`.
        dense: Probability of each friction at each joint of a robot that has several of them at
            once, a delay and torque ripple; None: `effects` only.
        severity: Scale each effect to this RMS torque after a refit of the base model, over the
            noise RMS [1].
        trusted: With `severity`: without the refit, as with a trusted prior.
        like: `.truth.json` of another recording: same robot, and effects of the same size.
        periods: Repeats of the excitation; None: as the trajectory states.
        **setting: Fields of the simulator's `ExperimentSettings`: seed, rate, noise, colour,
            jitter, encoder, model_error.

    Raises:
        UnusableInput: MuJoCo is not installed, or an argument or a file cannot be used.
    """
    require_mujoco()
    effects = one_or_several(effects)
    from ..simulator import (
        dense_robot,
        effect_instance,
        experiment,
        recording_file,
        reference_trajectory,
    )
    from ..simulator import severity as severities

    if severity is None and trusted:
        raise UnusableInput("--trusted: goes with --severity; add it, or leave --trusted out")
    if severity is not None and not effects and dense is None and like is None:
        raise UnusableInput("--severity: scales hidden effects; name one with --effect")
    given = {name: value for name, value in setting.items() if value is not None}
    stated = {
        "effects": effects or None,
        "dense": dense,
        "severity": severity,
        **{k: given.get(k) for k in ("seed", "model_error")},
    }
    source, sibling = (
        locate(str(robot)),
        None if like is None else _read_sibling(Path(like), stated),
    )
    description = urdf.read(source)  # the simulator has a reader of its own, which checks less
    chosen = _setting(given, None if sibling is None else sibling.setting)
    # the simulator has a reader of its own, which does not validate the file
    designed = trajectory_file.read_trajectory(Path(trajectory))
    motion = reference_trajectory.read_reference(Path(trajectory), periods)
    with _urdf_file(source, designed.limits) as file:
        plant = experiment.build_robot(file, motion, chosen)
    chain = experiment.measurement_chain(plant, chosen)
    if sibling is not None:
        if sibling.joints != plant.joints:
            raise UnusableInput(
                f"{like}: has joints {', '.join(sibling.joints)}; give the robot of that recording"
            )
        if (
            recording_file.json_text(recording_file.truth_document(plant, chain, {})["bodies"])
            != sibling.bodies
        ):
            raise UnusableInput(
                f"{like}: its links are not those of {source}; give the URDF of that recording"
            )
        hidden = sibling.effects
    else:
        hidden = tuple(effect_instance.parse_effect(text, plant) for text in effects)
        if dense is not None:
            hidden = (*hidden, *dense_robot.dense_effects(plant, motion, dense, chosen.seed))
    if severity is not None:
        if not severity > 0.0:
            raise UnusableInput(f"--severity {severity:g}: should be above 0")
        hidden = tuple(
            severities.scale_to_severity(effect, severity, plant, motion, chain, trusted=trusted)[0]
            for effect in hidden
        )
    disturbed = effect_instance.with_effects(plant, hidden)
    undisturbed = plant.follow(motion)
    session = experiment.run_session(
        disturbed, motion, chosen, motion=undisturbed if not hidden else None
    )
    refit = severities.evaluate_severity(session.motion, plant, motion, session.chain)
    unfitted = severities.evaluate_severity(
        session.motion, plant, motion, session.chain, trusted=True
    )
    facts = {
        "robot": {"name": str(robot), "source": str(source)},
        "trajectory": str(trajectory),
        "effects": [effect.to_document() for effect in hidden],
        "severity": dict(zip(plant.joints, refit.joints.tolist(), strict=True)),
        "severity_trusted": dict(zip(plant.joints, unfitted.joints.tolist(), strict=True)),
    }
    truth = {"schema": session.truth["schema"], **facts, **session.truth}
    units = {name: entry.unit("N m") for name, entry in description.joints.items()}
    return SimulatedRecording(
        session.recording,
        truth,
        hidden,
        undisturbed,
        refit.value,
        unfitted.value,
        units,
        argument_files(source, trajectory, like),
    )


@dataclass(frozen=True)
class _Sibling:
    """Robot of another recording, from its ground truth.

    Attributes:
        joints: Names of the joints.
        bodies: True link inertial parameters as JSON.
        setting: Settings of the simulator.
        effects: Hidden effects.
    """

    joints: tuple[str, ...]
    bodies: str
    setting: Any
    effects: tuple[Any, ...]


def _read_sibling(path: Path, stated: dict[str, Any]) -> _Sibling:
    """Read the robot of another recording.

    Args:
        path: Its `.truth.json`.
        stated: Options that the other recording decides, None where not stated.

    Raises:
        UnusableInput: The file cannot be used, or such an option is stated.
    """
    from ..simulator import effect_instance, experiment, recording_file

    for name, value in stated.items():
        if value is not None:
            option = "effect" if name == "effects" else name.replace("_", "-")
            raise UnusableInput(
                f"--{option}: is stated by {path}; leave it out, or leave out --like"
            )
    file = DocumentFile(
        path, "a truth", "simulate it again", "the .truth.json of 'excite simulate'"
    )
    truth = file.json()
    file.schema(truth, (SCHEMA,))
    document = file.converted(truth, TruthDocument)
    try:
        effects = effect_instance.effects_of_truth(truth)
    except (KeyError, ValueError) as error:  # the schema does not know the simulator's effects
        raise file.error(f"no such effect ({error})", "effects") from error
    bodies = recording_file.json_text(truth["bodies"])
    return _Sibling(
        tuple(document.joints),
        bodies,
        experiment.ExperimentSettings.from_document(truth["setting"]),
        effects,
    )


@contextmanager
def _urdf_file(source: Path, limits: Limits) -> Iterator[Path]:
    """The robot's file where it is a URDF, else a temporary URDF that it is converted to.

    An MJCF has no velocity limits; those of the trajectory fill the gaps.
    """
    text = source_text.read_urdf_text(source)
    if text == xml_file.read_text(source, "a URDF"):
        yield source
        return
    root = xml_file.parse_text(source, text)
    for joint in root.findall("joint"):
        if joint.get("name") not in limits.joints:
            continue
        place = limits.joints.index(str(joint.get("name")))
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit")
        known = {"velocity": limits.velocity[place], "effort": limits.torque[place]}
        for key, value in known.items():
            limit.attrib.setdefault(key, repr(float(value)))
    text = ElementTree.tostring(root, encoding="unicode")
    with tempfile.TemporaryDirectory(prefix="excite-") as folder:
        file = Path(folder) / f"{source.stem}.urdf"
        file.write_text(text, encoding="utf-8")
        yield file


def _setting(given: dict[str, Any], like: Any) -> Any:
    """Return the settings of the simulator.

    Args:
        given: Stated settings.
        like: Settings of another recording; None: the defaults.

    Raises:
        UnusableInput: A setting is out of its range.
    """
    from ..simulator.experiment import ExperimentSettings

    lower_bounds = {
        "seed": 0.0,
        "rate": 125.0,
        "noise": 0.0,
        "jitter": 0.0,
        "encoder": 0.0,
        "model_error": 0.0,
    }
    for name, low in lower_bounds.items():
        value = given.get(name, low)
        if not np.isfinite(value) or value < low or (name == "rate" and value > 1000.0):
            remedy = "be between 125 and 1000 Hz" if name == "rate" else "be a number not below 0"
            raise UnusableInput(f"--{name.replace('_', '-')} {value:g}: should {remedy}")
    out = replace(ExperimentSettings() if like is None else like, **given)
    if out.colour is not None and not 0.0 < out.colour < 0.5 * out.rate:
        raise UnusableInput(f"--colour {out.colour:g}: should be above 0 and below half the --rate")
    if out.jitter * out.rate > 1.0:
        raise UnusableInput(
            f"--jitter {out.jitter:g}: should be at most the time between two rows, "
            f"{1.0 / out.rate:g} s"
        )
    return out

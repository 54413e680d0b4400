"""`excite simulate`: a robot on the bench, with what it hides; the only door between the rest of excite and its plant."""

from __future__ import annotations

import argparse
import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._system.output_files import output_files
from ..errors import UnusableInput
from ..robot import robot, urdf
from ..schemas.document_file import DocumentFile
from ..schemas.truth import SCHEMA, TruthDocument
from ..trajectory import trajectory_file

Array = np.ndarray


def command(arguments: argparse.Namespace) -> tuple[int, Any, str]:
    """Simulate, measure, write the recording, its sidecar, its truth and a plot."""
    if importlib.util.find_spec("mujoco") is None:
        raise UnusableInput(
            "MuJoCo is not installed: pip install 'excite[trial]' (in a clone: .venv/bin/pip install -e '.[trial]')"
        )
    from ..simulator import (
        effect_instance,
        experiment,
        recording_file,
        reference_trajectory,
        severity,
    )

    out = Path(arguments.out)
    if out.suffix != ".csv":
        raise UnusableInput(
            f"-o {out}: should end in .csv; its sidecar, truth and plot take the same name"
        )
    siblings = (f"{out.stem}.json", f"{out.stem}.truth.json", f"{out.stem}.svg")
    inputs = [
        Path(path)
        for path in (arguments.robot, arguments.trajectory, arguments.like)
        if path is not None
    ]
    output = output_files(out, siblings, inputs)
    source, like = robot.locate(arguments.robot), _like(arguments)
    urdf.read(source)  # the simulator, which shares nothing with the rest, checks less
    setting = _setting(arguments, like)
    trajectory_file.read(
        Path(arguments.trajectory)
    )  # the simulator reads it by itself, but validates nothing
    motion = reference_trajectory.read(Path(arguments.trajectory), arguments.periods)
    plant = experiment.robot(source, motion, setting)
    chain = experiment.chain(plant, setting)
    if like is not None and like.joints != plant.joints:
        raise UnusableInput(
            f"{arguments.like}: has joints {', '.join(like.joints)}; give the robot that it is of"
        )
    if (
        like is not None
        and recording_file.dumps(recording_file.truth(plant, chain, {})["bodies"]) != like.bodies
    ):
        raise UnusableInput(
            f"{arguments.like}: its bodies are not those of {source}; give the URDF that it was recorded with"
        )
    effects = (
        tuple(effect_instance.parse(text, plant) for text in arguments.effect)
        if like is None
        else like.effects
    )
    if arguments.severity is not None:
        effects = tuple(
            severity.reach(
                one, arguments.severity, plant, motion, chain, trusted=arguments.trusted
            )[0]
            for one in effects
        )
    with_effects = effect_instance.hide(plant, effects)
    bare = plant.run(motion)
    session = experiment.session(with_effects, motion, setting, run=bare if not effects else None)
    found = severity.of(session.run, plant, motion, session.chain)
    trusted = severity.of(session.run, plant, motion, session.chain, trusted=True)
    facts = {
        "robot": {"name": arguments.robot, "source": str(source)},
        "trajectory": arguments.trajectory,
        "effects": [one.document() for one in effects],
        "severity": dict(zip(plant.joints, found.joints.tolist(), strict=True)),
        "severity_trusted": dict(zip(plant.joints, trusted.joints.tolist(), strict=True)),
    }
    truth = {"schema": session.truth["schema"], **facts, **session.truth}
    sidecar, stated = recording_file.dumps(session.recording.sidecar()), recording_file.dumps(truth)
    texts = (session.recording.csv(), sidecar, stated, _picture(session.recording, bare, effects))
    written = [
        str(path) for path in output.replace(dict(zip((out.name, *siblings), texts, strict=True)))
    ]
    document = {
        "files": written,
        "joints": list(plant.joints),
        "rows": len(session.recording.t),
        **facts,
    }
    return 0, document, _text(document, effects, found.value, trusted.value)


@dataclass(frozen=True)
class _Robot:
    """What a truth says of its robot. bodies: as JSON."""

    joints: tuple[str, ...]
    bodies: str
    setting: Any
    effects: tuple[Any, ...]


def _like(arguments: argparse.Namespace) -> _Robot | None:
    """The robot of another recording, if that is what is asked for."""
    if arguments.like is None:
        return None
    from ..simulator import effect_instance, experiment, recording_file

    for name in ("effect", "severity", "seed", "model_error"):
        if getattr(arguments, name) not in (None, []):
            raise UnusableInput(
                f"--{name.replace('_', '-')}: is as {arguments.like} says; leave it out, or leave out --like"
            )
    file = DocumentFile(
        Path(arguments.like), "a truth", "simulate it again", "the .truth.json of 'excite simulate'"
    )
    truth = file.json()
    file.schema(truth, (SCHEMA,))
    document = file.converted(truth, TruthDocument)
    try:
        effects = effect_instance.stated(truth)
    except (
        KeyError,
        ValueError,
    ) as error:  # the catalogue of hidden effects is the simulator's own
        raise file.error(f"no such effect ({error})", "effects") from error
    return _Robot(
        tuple(document.joints),
        recording_file.dumps(truth["bodies"]),
        experiment.Setting.stated(truth["setting"]),
        effects,
    )


def _setting(arguments: argparse.Namespace, like: _Robot | None) -> Any:
    """As asked for, and what was not asked for as it was, or as usual."""
    from ..simulator.experiment import Setting

    names = ("seed", "rate", "noise", "colour", "jitter", "encoder", "model_error")
    asked = {
        name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None
    }
    out = replace(Setting() if like is None else like.setting, **asked)
    if out.colour is not None and not 0.0 < out.colour < 0.5 * out.rate:
        raise UnusableInput(f"--colour {out.colour:g}: should be above 0 and below half the --rate")
    return out


def _text(
    document: dict[str, Any], effects: tuple[Any, ...], survives: float, trusted: float
) -> str:
    lines = [
        f"{one.name}{'' if one.joint is None else ' in ' + one.joint}: "
        + ", ".join(
            f"{q.name} {one.values[q.name]:.4g}{'' if q.unit == '1' else ' ' + q.unit}"
            for q in one.kind.quantities
        )
        for one in effects
    ]
    if effects:
        lines.append(
            f"severity {survives:.3g} (what a refit of the base model leaves, over the noise below 20 Hz), {trusted:.3g} without refit"
        )
    else:
        lines.append("nothing hidden; name what to hide: --effect NAME:JOINT[:k=v,…]")
    truth = next(path for path in document["files"] if path.endswith(".truth.json"))
    return "\n".join(
        [
            *lines,
            *(f"wrote {path}" for path in document["files"]),
            f"the same robot on another motion: --like {truth}",
        ]
    )


def _picture(recording: Any, bare: Any, effects: tuple[Any, ...]) -> str:
    """Torque as recorded, without the effects, and what they change, joint by joint."""
    from ..report.figures.drawing import BLUE, GREY, ORANGE, few_ticks, grid, render, thin

    joints, t = recording.joints, recording.t
    plain = bare.torque(t)
    change = recording.tau - plain
    hidden = " + ".join(one.name for one in effects) or "nothing hidden"

    def draw(figure: Any) -> None:
        axes = grid(figure, len(joints), 2, margins=(0.65, 0.15, 0.45, 0.4), gaps=(0.6, 0.22))
        for j, joint in enumerate(joints):
            left, right = axes[j]
            left.plot(*thin(t, recording.tau[:, j], 1200), color=BLUE, label="recorded")
            left.plot(
                *thin(t, plain[:, j], 1200),
                color=ORANGE,
                label="the same robot, nothing hidden, no noise",
            )
            right.plot(*thin(t, change[:, j], 1200), color=GREY, label="difference")
            left.set_ylabel("N m")
            left.set_title(joint, loc="left", pad=3)
            for axis in (left, right):
                few_ticks(axis, 6)
                axis.set_xlim(0.0, t[-1])
                axis.tick_params(labelbottom=j == len(joints) - 1)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        axes[0, 1].set_title(f"difference: {hidden}, and noise", loc="right", pad=3)
        for axis in axes[-1]:
            axis.set_xlabel("t [s]")

    svg = render(f"Torque with and without {hidden}", 0.85 + 1.15 * len(joints), draw)
    return svg.replace(
        "<svg ",
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" ',
        1,
    )

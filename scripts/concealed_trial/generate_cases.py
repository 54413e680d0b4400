"""A case on disk: what the analyst is given in one folder, what it must not know in another."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from excite.errors import UnusableInput
from excite.simulator import effect_instance as effects
from excite.simulator import experiment, recording_file, severity
from excite.simulator import urdf_tree as trees
from excite.simulator.actuator import Control, Drive
from excite.simulator.effect_instance import Effect
from excite.simulator.effects import KINDS
from excite.simulator.experiment import Session, Setting
from excite.simulator.reference_trajectory import Reference
from excite.simulator.simulated_robot import Plant

from . import random_excitation
from .baseline_fit import oracle
from .case_plan import Spec

Array = np.ndarray
NOISE, COARSE, JITTER, STEP = 0.002, 2.0 * np.pi / 2**16, 5e-5, 2e-3
CHANGES = 0.1, 0.3
"""Of friction, by how much it is another on another day."""
LARGEST = 10.0
"""An effect is at most this many times its usual size, whatever severity was asked for."""
DRAWS, FURTHER, SHOWS = 3, 12, 0.5
"""Times that a robot, or an effect's place and size, is drawn; how often at the most where none shows this severity: what is not in the
recording (a limit that the torque never comes to, drag of a robot that crawls) is no truth to be found."""


@dataclass(frozen=True)
class Bench:
    """A case before it is written. plant: the robot without what it hides. hidden: (effect, its severity alone).

    sessions: the recording to learn from and the one to judge by. motion: of the first.
    """

    spec: Spec
    urdf: str
    plant: Plant
    hidden: tuple[tuple[Effect, float], ...]
    sessions: tuple[Session, ...]
    motion: Reference


def setting(spec: Spec) -> Setting:
    """Measurement and controller of a case, with its trap. The true bodies are the URDF's where a prior is trusted."""
    rng = np.random.default_rng([spec.seed, 1])
    control = Control(
        position=float(rng.uniform(20.0, 40.0)),
        speed=float(rng.uniform(120.0, 200.0)),
        forward=float(rng.uniform(0.6, 0.95)),
    )
    if spec.trap == "changed_gains":
        control = replace(control, position=8.0, speed=60.0, forward=0.3)
    return Setting(
        seed=int(rng.integers(2**31)),
        noise=NOISE * (5.0 if spec.trap == "heavy_noise" else float(rng.uniform(0.7, 1.4))),
        colour=8.0 if spec.trap == "coloured_noise" else None,
        jitter=JITTER if spec.trap == "jitter" else 0.0,
        encoder=COARSE if spec.trap == "coarse_encoder" else 2e-6,
        model_error=0.0 if spec.trusted else 0.05,
        control=control,
    )


def bench(spec: Spec, models: Path) -> Bench:
    """Simulate a case. models: folder of the robots' URDFs. The same spec gives the same numbers.

    A robot that its controller loses whatever is hidden, or where an effect does not show by itself, is drawn anew; at last without the
    trap, or as it is. Raises UnusableInput where all are lost.
    """
    for again in range(DRAWS - 1):
        with suppress(UnusableInput):
            return _drawn(replace(spec, seed=spec.seed + again), models, SHOWS)
    last = replace(spec, seed=spec.seed + DRAWS - 1)
    with suppress(UnusableInput):
        return _drawn(replace(last, trap="none"), models, SHOWS)
    return _drawn(last, models, 0.0)


def _drawn(spec: Spec, models: Path, least: float) -> Bench:
    """A case, every effect of which shows a severity of `least` by itself."""
    rng, chosen, path = (
        np.random.default_rng([spec.seed, 2]),
        setting(spec),
        models / f"{spec.robot}.urdf",
    )
    tree = trees.read(path)
    plant = experiment.robot(path, _standing(tree.joints), chosen)
    # where a prior is trusted, the handed-over URDF is right, to the last digit
    plant = replace(plant, step=STEP, tree=tree if spec.trusted else plant.tree)
    poor = spec.trap == "poor_excitation"
    states = [
        np.random.default_rng([spec.seed, 3]),
        np.random.default_rng([spec.seed, 3]),
        np.random.default_rng([spec.seed, 4]),
    ]
    short, train, validate = (
        random_excitation.draw(plant, n, state, poor=poor)
        for n, state in zip((1, 2, 1), states, strict=True)
    )
    hidden: list[tuple[Effect, float]] = []
    for name, level in zip(spec.names, spec.severities, strict=True):
        # of two effects most sit in one joint, where they mask each other
        joint = hidden[0][0].joint if hidden and rng.random() < 0.6 else None
        hidden.append(_effect(spec, name, level, plant, chosen, (short, train), joint, rng, least))
    return _measured(Bench(spec, tree.text, plant, tuple(hidden), (), train), validate, chosen)


def _measured(case: Bench, validate: Reference, chosen: Setting) -> Bench:
    """The case with its two recordings; effects that together are more than the controller can hold are made smaller."""
    for _ in range(4):
        robot = effects.hide(case.plant, tuple(effect for effect, _ in case.hidden))
        try:
            first = experiment.session(robot, case.motion, chosen)
            second = experiment.session(
                replace(robot, drive=_later(case)), validate, replace(chosen, seed=chosen.seed + 1)
            )
        except UnusableInput:
            case = replace(
                case,
                hidden=tuple((effect.sized(0.3), 0.3 * alone) for effect, alone in case.hidden),
            )
            continue
        return replace(case, sessions=(first, second))
    raise UnusableInput(
        f"case {case.spec.name}: the controller loses this robot whatever is hidden; plan another seed"
    )


def _later(case: Bench) -> Drive:
    """The drives as they are when the second recording is made: on another day colder or warmer, all of them, each about as much."""
    drive = case.plant.drive
    if case.spec.trap != "another_day":
        return drive
    rng = np.random.default_rng([case.spec.seed, 5])
    factor = 1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(*CHANGES) * rng.uniform(
        0.8, 1.2, len(case.plant.joints)
    )
    return replace(drive, viscous=factor * drive.viscous, coulomb=factor * drive.coulomb)


def _standing(joints: tuple[str, ...]) -> Reference:
    """A reference that only names the joints."""
    return Reference(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})


def given(case: Bench) -> dict[str, str]:
    """Files of the analyst's folder: nothing in them but what a laboratory would hand over."""
    out = {"robot.urdf": case.urdf}
    for name, session in zip(("train", "validate"), case.sessions, strict=True):
        out[f"{name}.csv"] = session.recording.csv()
        out[f"{name}.json"] = recording_file.dumps({**session.recording.sidecar(), "notes": ""})
    if case.spec.trusted:
        out["prior.json"] = _prior(case.plant)
    return out


def _effect(
    spec: Spec,
    name: str,
    level: float,
    plant: Plant,
    chosen: Setting,
    motions: tuple[Reference, Reference],
    joint: str | None,
    rng: np.random.Generator,
    least: float,
) -> tuple[Effect, float]:
    """An effect of random size and place (`joint` first, where it may sit there), scaled to its severity; and the severity reached.

    Where a joint shows too little of it whatever its size (a wrist that hardly loads its spring), or the controller loses the
    robot at any, another draw is made; and more where none shows. Raises UnusableInput where none shows a severity of `least`.
    """
    kind, n, (short, whole) = KINDS[name], len(plant.joints), motions
    first = {"payload": n // 2, "contact": n // 2}.get(name, 0)
    end = max(n - 1, 1) if name == "kinematic_error" else n
    chain, along = experiment.chain(plant, chosen), whole if name == "thermal_drift" else short
    all_late = rng.random() < 0.3
    found: list[tuple[float, Effect, float]] = []
    for draw in range(FURTHER):
        if draw >= DRAWS and (not found or max(value for _, _, value in found) > SHOWS):
            break
        drawn = plant.joints[int(rng.integers(first, end))]
        where = joint if draw == 0 and joint in plant.joints[first:end] else drawn
        place = None if kind.place == "robot" or (kind.place == "either" and all_late) else where
        effect = effects.draw(kind, plant, place, spec.family, rng)
        try:
            sized, _, reached = severity.reach(
                effect,
                level,
                plant,
                along,
                chain,
                trusted=spec.trusted,
                tolerance=0.5,
                tries=3,
                largest=LARGEST,
            )
        except UnusableInput as error:
            lost = error
            continue
        found.append((abs(float(np.log(max(reached.value, 1e-9) / level))), sized, reached.value))
        if found[-1][0] < np.log(2.0):
            break
    if not found:
        raise lost
    shown = [entry for entry in found if entry[2] >= least]
    if not shown:
        raise UnusableInput(f"case {spec.name}: no joint shows {name}; plan another seed")
    _, best, value = min(shown, key=lambda entry: entry[0])
    return best, value


def _prior(plant: Plant) -> str:
    drive = plant.drive
    joints = {
        name: {
            "coulomb": float(drive.coulomb[j]),
            "viscous": float(drive.viscous[j]),
            "rotor_inertia": float(drive.inertia[j]),
            "offset": float(drive.offset[j]),
        }
        for j, name in enumerate(plant.joints)
    }
    return recording_file.dumps({"schema": "excite.prior/1", "trust_prior": True, "joints": joints})


def key(case: Bench, folder: Path) -> dict[str, Any]:
    """What the analyst must not know; `folder` holds the files it is given. held_out: RMSE of the second recording [N m]."""
    first, second = case.sessions
    before, after = oracle(
        folder,
        (_torque(first, case.plant), _torque(second, replace(case.plant, drive=_later(case)))),
    )
    whole = severity.of(first.run, case.plant, case.motion, first.chain, trusted=case.spec.trusted)
    return {
        "spec": asdict(case.spec),
        "joints": list(case.plant.joints),
        "effects": [{**effect.document(), "severity": alone} for effect, alone in case.hidden],
        "severity": whole.joints.tolist(),
        "held_out": {
            "before": before.tolist(),
            "oracle": after.tolist(),
            "noise": second.chain.floor(severity.BAND).tolist(),
        },
        "truth": first.truth,
    }


def _torque(session: Session, plant: Plant) -> Callable[[Array], Array]:
    return lambda t: severity.hidden(session.run, plant, t).torque


def write(case: Bench, folder: Path, secret: Path) -> None:
    """Put a case's files and its key into their places: a case whose folder is there is whole. All files bear one date."""
    staged = folder.with_name(f".{folder.name}")
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    for name, text in given(case).items():
        (staged / name).write_text(text, encoding="utf-8")
        os.utime(staged / name, (0, 0))
    secret.parent.mkdir(parents=True, exist_ok=True)
    secret.write_text(json.dumps(key(case, staged), allow_nan=False), encoding="utf-8")
    os.utime(staged, (0, 0))
    staged.rename(folder)

"""Documents are validated before use: faulty ones are refused in one line."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from document_mutations import mutated
from hypothesis import given, settings
from hypothesis import strategies as st
from shared_inputs import INPUTS, needs_inputs
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
    write_recording,
)

from excite import _json, physical_ranges, recordings
from excite.cli.main import main
from excite.collision import scene_file
from excite.diagnosis import fitted_effects, joint_model
from excite.effects import EFFECTS, contact, recorded_motion, torque_ripple
from excite.effects.effect import CandidateModel, Effect
from excite.effects.recorded_motion import RecordedMotion
from excite.errors import ExciteError, ExciteWarning, UnusableInput
from excite.identification import identification, prior, segments
from excite.robot import inertial_parameters, limits
from excite.robot.robot import load
from excite.schemas.document_file import DocumentFile
from excite.schemas.effects import EffectDocument
from excite.trajectory import trajectory_file
from excite.trajectory.trajectory_file import Trajectory

TRAJECTORIES = sorted((Path(__file__).parents[1] / "trajectories").glob("*.json"))
TWO_LINK = next(path for path in TRAJECTORIES if path.stem == "two_link")
Command = Callable[[Path], list[object]]


@dataclass(frozen=True)
class Result:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    @property
    def errors(self) -> list[str]:
        """Standard error without progress."""
        return [line for line in self.err.splitlines() if not line.startswith("reading ")]


def run(*words: object) -> Result:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(word) for word in words])
    return Result(code, out.getvalue(), err.getvalue())


# -- the shared faulty inputs ----------------------------------------------------------------------

FAULTY_TRAJECTORIES = {
    "t_big_int.json": "base_frequency",
    "t_gravity_short.json": "robot.gravity",
    "t_lim_neg.json": "limits.velocity.joint_1.value",
    "t_limits_empty.json": "limits.",
    "t_limits_null.json": "limits",
    "t_locked_int.json": "robot.locked",
    "t_margin_neg.json": "design.cell.margin",
    "t_nan_profile.json": "segments[3].profile.position[0]",
    "t_no_criteria.json": "criteria",
    "t_no_sha.json": "sha256",
    "t_payload_empty.json": "robot.payload",
    "t_period0.json": "period",
    "t_periods_2000.json": "segments[1]",
    "t_rate_nan.json": "rate",
    "t_segments_empty.json": "segments",
    "t_sine_1e308.json": "sine[0][0]",
    "t_sine_row_missing.json": "sine",
    "t_source_long.json": "robot.source",
    "deep.json": "nested",
    "digits.json": "schema",
    "spike.json": "criteria.optimum",
    "spike_criteria_kept.json": "limits.acceleration",
    "five_times_speed.json": "criteria.optimum",
    "limits_raised.json": "criteria.optimum",
    "urscript_injection.json": "segments[1].kind",
}
FAULTY_MODELS = {
    "m_band_tiny.json": "band_hz",
    "m_coef_inf.json": "effects[0].coefficients[0]",
    "m_effect_joint_null.json": "effects[0].values",  # of a form of former versions
    "m_effect_other.json": "effects[0].values",
    "m_effect_time.json": "effects[0].time",
    "m_effect_values_null.json": "effects[0].values",
    "m_effects_str.json": "effects",
    "m_gravity_nan.json": "robot.gravity[1]",
    "m_value_str.json": "effects[0].values.velocity",
    "m_width_nan.json": "coulomb_width.joint_1",
}
FAULTY_TRUTHS = {
    "like_amp_nan.json": "effects[0].parameters.amplitude.value",
    "like_lag0.json": "setting.control.lag",
    "like_rate_1e9.json": "setting.rate",
    "like_rate_str.json": "setting.rate",
    "like_seed_neg.json": "setting.seed",
}
FAULTY_LIMITS = {
    "l_1e308.toml": "joints.joint_1.velocity",
    "deep.toml": "nested",
    "deep.yaml": "nested",
}
FAULTY_PRIORS = {
    "p_negative.json": "joints.joint_1.coulomb",
    "p_1e308.json": "joints.joint_1.coulomb",
}
FAULTY_BOUNDS = {
    "b_neg.toml": "links.link_1.mass[0]",
    "b_tiny.toml": "links.link_1.mass[1]",
}
FAULTY_SIDECARS = {
    "r_side_deep": "nested",
    "r_side_gain_bigint": "drive_gain.joint_1",
    "r_side_gain_nobody": "'nobody'",
    "r_side_period_1e308": "period",
    "r_side_window_1ns": "periodic",
}


def refused(path: str, key: str, folder: Path, *words: object) -> None:
    """Check that a command refuses a file in one line with file and key, and writes nothing."""
    result = run(*words)
    assert result.code == 2 and result.out == ""
    assert len(result.errors) == 1, result.err
    assert result.errors[0].startswith("excite: ")
    assert path in result.errors[0] and key in result.errors[0]
    assert not list(folder.iterdir())


@needs_inputs
@pytest.mark.parametrize("name", FAULTY_TRAJECTORIES)
@pytest.mark.parametrize("command", ["verify", "export", "simulate"])
def test_a_faulty_trajectory_is_refused(name, command, tmp_path):
    assert INPUTS is not None
    words: dict[str, list[object]] = {
        "verify": ["verify", INPUTS / name],
        "export": [
            *("export", INPUTS / name, "--format", "urscript"),
            *("-o", tmp_path / "x.script"),
        ],
        "simulate": ["simulate", "two_link", INPUTS / name, "-o", tmp_path / "o.csv"],
    }
    if command == "simulate":
        pytest.importorskip("mujoco")
    refused(name, FAULTY_TRAJECTORIES[name], tmp_path, *words[command])


@needs_inputs
@pytest.mark.parametrize("name", FAULTY_MODELS)
def test_a_faulty_model_is_refused(name, tmp_path):
    assert INPUTS is not None
    key, out = FAULTY_MODELS[name], tmp_path / "o.csv"
    refused(name, key, tmp_path, "predict", INPUTS / name, INPUTS / "short.csv", "-o", out)
    words = ("identify", "two_link", INPUTS / "good.csv", "--prior", INPUTS / name)
    refused(name, key, tmp_path, *words, "-o", tmp_path / "out")


@needs_inputs
@pytest.mark.parametrize("name", FAULTY_TRUTHS)
def test_a_faulty_truth_is_refused(name, tmp_path):
    pytest.importorskip("mujoco")
    assert INPUTS is not None
    words = ("simulate", "two_link", INPUTS / "trajectory_good.json", "--like", INPUTS / name)
    refused(name, FAULTY_TRUTHS[name], tmp_path, *words, "-o", tmp_path / "o.csv")


@needs_inputs
@pytest.mark.parametrize("name", FAULTY_LIMITS)
def test_a_faulty_limits_file_is_refused(name, tmp_path):
    assert INPUTS is not None
    words = ("design", "two_link", "--limits", INPUTS / name, "-o", tmp_path / "out")
    refused(name, FAULTY_LIMITS[name], tmp_path, *words)


@needs_inputs
def test_a_faulty_scene_is_refused(tmp_path):
    assert INPUTS is not None
    words = ("design", "two_link", "--scene", INPUTS / "s_floor.toml", "-o", tmp_path / "out")
    refused("s_floor.toml", "floor", tmp_path, *words)


@needs_inputs
@pytest.mark.parametrize("name", [*FAULTY_PRIORS, *FAULTY_BOUNDS])
def test_a_faulty_prior_or_bound_is_refused(name, tmp_path):
    assert INPUTS is not None
    option = "--prior" if name in FAULTY_PRIORS else "--bounds"
    words = ("identify", "two_link", INPUTS / "good.csv", option, INPUTS / name)
    key = (FAULTY_PRIORS | FAULTY_BOUNDS)[name]
    refused(name, key, tmp_path, *words, "-o", tmp_path / "out")


@needs_inputs
@pytest.mark.parametrize("name", FAULTY_SIDECARS)
def test_a_faulty_sidecar_is_refused(name, tmp_path):
    assert INPUTS is not None
    words = ("identify", "two_link", INPUTS / f"{name}.csv", "-o", tmp_path / "out")
    refused(f"{name}.json", FAULTY_SIDECARS[name], tmp_path, *words)


@needs_inputs
def test_valid_files_are_accepted(tmp_path):
    assert INPUTS is not None
    assert run("verify", INPUTS / "trajectory_good.json").code in (0, 1)
    out = tmp_path / "out"
    words = ("identify", "two_link", INPUTS / "good.csv", "--validate", INPUTS / "good2.csv")
    assert run(*words, "-o", out).code == 0
    words = ("predict", out / "model.json", INPUTS / "short.csv", "-o", tmp_path / "o.csv")
    assert run(*words).code == 0
    with pytest.raises(UnusableInput, match=r"the mesh .*wall\.stl does not exist"):
        scene_file.read(INPUTS / "s_mesh.toml")


# -- reading ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", TRAJECTORIES, ids=lambda path: path.stem)
def test_published_trajectories_read_back_exactly(path):
    trajectory = trajectory_file.read_trajectory(path)
    assert _json.dumps(trajectory.document()) == _json.dumps(
        json.loads(path.read_text(encoding="utf-8"))
    )


names = st.text(
    st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp")), min_size=1, max_size=30
).filter(str.strip)


texts = st.text(st.characters(exclude_categories=("Cs",)))
LIMITED = ("position", "velocity", "acceleration", "jerk", "torque")
"""Quantities with limits."""


def changed_trajectory(trajectory: Trajectory, content: dict[str, Any]) -> Trajectory:
    """Return a trajectory with other names, seed, noise and sources of limits."""
    joints = tuple(content["joints"])
    sources = {quantity: tuple(content[quantity]) for quantity in trajectory.limits.sources}
    return replace(
        trajectory,
        motion=replace(trajectory.motion, joints=joints),
        limits=replace(trajectory.limits, joints=joints, sources=sources),
        robot={**trajectory.robot, "name": content["robot"]},
        noise=np.array(content["noise"]),
        seed=content["seed"],
        collision=content["collision"],
        forced=content["forced"],
    )


CONTENTS = st.fixed_dictionaries(
    {
        "joints": st.lists(names, min_size=2, max_size=2, unique=True),
        "robot": names,
        "noise": st.lists(st.floats(1e-6, 1e6), min_size=2, max_size=2),
        "seed": st.integers(0, int(physical_ranges.SEED.upper)),
        "collision": texts,
        "forced": st.booleans(),
        **{quantity: st.lists(texts, min_size=2, max_size=2) for quantity in LIMITED},
    }
)


@settings(max_examples=60)
@given(content=CONTENTS)
def test_a_trajectory_is_read_back_exactly(delivery, tmp_path_factory, content):
    trajectory = changed_trajectory(delivery.trajectory, content)
    path = tmp_path_factory.getbasetemp() / "again.json"
    path.write_text(_json.dumps(trajectory.document()), encoding="utf-8")
    again = trajectory_file.read_trajectory(path)
    assert again.joints == trajectory.joints and again.motion.periods == trajectory.motion.periods
    assert _json.dumps(again.document()) == path.read_text(encoding="utf-8")
    t = trajectory.motion.grid(50.0)
    for order in range(4):
        assert np.array_equal(again.motion.at(t, order), trajectory.motion.at(t, order))


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"[" * 10_000, "nested more than 40 deep"),
        (b'{"a": ' * 45 + b"1" + b"}" * 45, "nested more than 40 deep"),
        (b'{"schema": 1, "schema": 2}', "the key 'schema' occurs twice in one table"),
        ('{"schema": "excite.trajectory/1"}'.encode("utf-16"), "line 1 is not UTF-8"),
        (b"\n\n\xff", "line 3 is not UTF-8"),
        (b'{"a": {"b": [1, NaN]}}', "a.b[1]: the number is not finite"),
        (b'{"a": -Infinity}', "a: the number is not finite"),
        (b'{"a": 1' + b"0" * 400 + b"}", "a: the number is not finite, or too large"),
        (b'{"a": 1' + b"0" * 6000 + b"}", "a: the number is not finite, or too large"),
        (b'{"a": "\\ud800"}', "a: the text has the half character U+D800"),
        (b'{"a": {"b\\nc": 1}}', "a: the key 'b\\\\nc' has the control character U+000A"),
        (b'{"' + b"k" * 2000 + b'": 1}', "a key has 2000 characters"),
        (b" " * ((1 << 25) + 1), "larger than 32768 KiB"),
        (b"{} {}", "line 1, column 4: Extra data"),
        (b'{"schema": "excite.trajectory/2"}', "its schema is 'excite.trajectory/2'"),
        (b"[]", "its schema is null, not 'excite.trajectory/1'"),
    ],
)
def test_invalid_json_is_refused(data, problem, tmp_path):
    path = tmp_path / "t.json"
    path.write_bytes(data)
    with pytest.raises(UnusableInput) as caught:
        trajectory_file.read_trajectory(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and problem.replace("\\\\", "\\") in message
    assert "\n" not in message and len(message) < 400


def test_a_byte_order_mark_is_accepted(tmp_path):
    path = tmp_path / "t.json"
    path.write_bytes(b"\xef\xbb\xbf" + TRAJECTORIES[0].read_bytes())
    assert trajectory_file.read_trajectory(path).joints


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[" * 5000, "nested"),
        ("joint_limits: {a: &x {}, b: *x}", "line 1, column 29: the alias .x is not read"),
        ("joint_limits: {a: {}, a: {}}", "the key 'a' occurs twice"),
        ("joint_limits: {a: {max_jerk: !!timestamp x}}", "cannot be read as a limits file"),
        ("joint_limits: {a: !!python/object:os.system {}}", "cannot be read as a limits file"),
        ("joint_limits: {? [1] : 1}", "a key should be a text"),
        ("joint_limits: {a: {has_jerk_limits: true, max_jerk: .nan}}", "max_jerk"),
        ("x: 1" + "0" * 6000, "cannot be read as a limits file"),
        ("# " + "x" * (1 << 18), "larger than 256 KiB"),
    ],
)
def test_invalid_yaml_is_refused(text, problem, tmp_path):
    path = tmp_path / "l.yaml"
    path.write_text(text)
    with pytest.raises(UnusableInput, match=problem):
        limits.resolve(load("two_link"), path)


def test_yaml_keys_that_look_like_numbers_or_switches_are_names(tmp_path):
    path = tmp_path / "l.yaml"
    path.write_text("joint_limits: {1: {}, on: {}, joint_1: {has_jerk_limits: true, max_jerk: 9}}")
    with pytest.warns(ExciteWarning, match="joint '(1|on)' is not in two_link"):
        assert limits.resolve(load("two_link"), path).jerk[0] == 9.0


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d["limits"]["jerk"]["joint_2"].update(value=-1), "limits.jerk.joint_2.value"),
        (lambda d: d["limits"]["jerk"].pop("joint_2"), "limits.jerk: has no entry for the joint"),
        (
            lambda d: d["limits"]["torque"].update(elbow={"value": 1.0}),
            "limits.torque: 'elbow' is none of the joints",
        ),
        (
            lambda d: d["segments"][0]["profile"]["pieces"]["joint_2"][1].append(1),
            "segments[0].profile.pieces.joint_2[1]: should hold 2 values, not 3",
        ),
        (lambda d: d["segments"].reverse(), "segments[0].start"),
        (
            lambda d: d["segments"][0].update(kind="return"),
            "segments[1].kind: ramp_in cannot follow return",
        ),
        (lambda d: d["segments"][0].pop("profile"), "segments[0]: the approach has no profile"),
        (lambda d: d["segments"].pop(2), "segments: should hold one Fourier part, not 0"),
        (lambda d: d["segments"][1].update(start=0.0), "segments[1].start: 0 s is not where"),
        (lambda d: d["joints"].reverse(), None),
        (lambda d: d.update(joints=["joint_1", "joint_1"]), "joints: 'joint_1' is named twice"),
        (lambda d: d.update(harmonics=101), "harmonics: 101 should be from 1 to 100"),
        (lambda d: d.update(rate=2e5), "rate: 200000.0 should be from 0.001 to 100000 Hz"),
        (lambda d: d["design"].update(samples=10**6), "design.samples"),
        (lambda d: d["design"].update(drive=["viscous"] * 2), "design.drive"),
        (lambda d: d["design"].update(drive=["ohm"]), "design.drive[0]: 'ohm' is none of"),
        (lambda d: d["robot"].update(sha256="0" * 63 + "g"), "robot.sha256"),
        (lambda d: d["robot"].update(name="a\u2028b"), "robot.name"),
        (lambda d: d["robot"].update(locked={"a": 1e7}), "robot.locked.a: 10000000.0 should be"),
        (lambda d: d["torque_noise"].update(joint_1=0.0), "torque_noise.joint_1"),
        (lambda d: d["criteria"]["exported"]["plain"].pop("cond"), "criteria.exported.plain"),
        (lambda d: d.update(collision=3), "collision: 3 should be a text"),
        (lambda d: d.update(later_versions="may add keys"), None),
    ],
)
def test_each_rule_of_a_trajectory_names_its_key(delivery, change, problem, tmp_path):
    content = json.loads(_json.dumps(delivery.trajectory.document()))
    change(content)
    if problem is None:
        assert trajectory_file.parse_trajectory(content, tmp_path / "t.json").joints
        return
    with pytest.raises(UnusableInput) as caught:
        trajectory_file.parse_trajectory(content, tmp_path / "t.json")
    assert f"t.json: {problem}" in str(caught.value)
    assert str(caught.value).endswith("; design it again")


def test_help_needs_no_schema():
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "excite", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    imported = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines()}
    assert "argparse" in imported and "msgspec" not in imported


# -- mutations: accepted or refused ---------------------------------------------------------------


def finite(text: str) -> bool:
    """Return True if all numbers of a CSV or JSON text are finite."""
    lower = text.lower()
    return not any(word in lower.replace("infin", "") for word in ("nan,", ",nan", "nan\n", ",inf"))


def tried(text: str, path: Path, use: Callable[[Path], object]) -> None:
    """Use a mutated document; only UnusableInput with a message of one line may be raised."""
    path.write_text(text, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExciteWarning)
        try:
            use(path)
        except ExciteError as error:
            assert "\n" not in str(error) and len(str(error)) < 1000


def commanded(text: str, path: Path, command: Command, out: Path | None = None) -> None:
    """Run a command with a mutated document; check exit codes 0 to 2 and finite numbers."""
    path.write_text(text, encoding="utf-8")
    result = run(*command(path))
    assert result.code in (0, 1, 2)
    assert finite(result.out)
    if result.code == 2:
        assert sum(line.startswith("excite: ") for line in result.errors) == 1
    if out is not None and out.exists():
        assert result.code != 2 and finite(out.read_text(encoding="utf-8"))
        out.unlink()


@pytest.fixture(scope="module")
def designed() -> dict[str, Any]:
    """Document of a trajectory with a cell."""
    content: dict[str, Any] = json.loads(TWO_LINK.read_text(encoding="utf-8"))
    return content


@settings(max_examples=120)
@given(data=st.data())
def test_a_mutated_trajectory_is_verified_or_refused(designed, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "t.json"
    commanded(data.draw(mutated(designed)), path, lambda path: ["verify", path, "--json"])


@settings(max_examples=60)
@given(data=st.data())
def test_a_mutated_trajectory_is_exported_or_refused(designed, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "t.json"
    out = path.with_name("o.csv")
    words = ("--format", "csv", "--force", "-o", out)
    commanded(data.draw(mutated(designed)), path, lambda path: ["export", path, *words], out)


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two recordings of a two-link robot and the model of the first."""
    folder = tmp_path_factory.mktemp("identified")
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    write_recording(
        synthetic_recording(subject, psi, random_fourier(2, 2), 3, 0.2), folder / "train.csv"
    )
    write_recording(
        synthetic_recording(subject, psi, random_fourier(2, 5), 0.6, 0.2), folder / "short.csv"
    )
    (folder / "short.json").unlink()
    assert run("identify", "two_link", folder / "train.csv", "-o", folder / "model").code == 0
    return folder


EFFECT_ENTRIES = (
    {
        "effect": "stribeck",
        "joint": "joint_1",
        "from": None,
        "values": {"top_speed": 2.0},
        "coefficients": [4.0, 0.9, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0],
        "time": None,
        "recording": None,
    },
    {
        "effect": "base_compliance",
        "joint": None,
        "from": None,
        "values": {"frequency": 8.0, "damping": 0.1, "way": 1.0, "stand": 0.2, "apart": 1.1},
        "coefficients": [1.0, 1.0],
        "time": None,
        "recording": None,
    },
    {
        "effect": "backlash",
        "joint": "joint_2",
        "from": None,
        "values": {"width": 1e-3, "hold": 3.0},
        "coefficients": [1.0],
        "time": None,
        "recording": None,
    },
    {
        "effect": "torque_saturation",
        "joint": "joint_1",
        "from": None,
        "values": {"level": 40.0, "bend": 2.0, "largest": 50.0, "measured": 1.0},
        "coefficients": [0.5],
        "time": None,
        "recording": None,
    },
)


@settings(max_examples=120)
@given(data=st.data())
def test_a_mutated_model_predicts_or_is_refused(identified, data):
    content = json.loads((identified / "model" / "model.json").read_text(encoding="utf-8"))
    used = ("schema", "robot", "joints", "links", "drive", "standard_parameters", "coulomb_width")
    content = {key: content[key] for key in (*used, "band_hz", "urdf")}
    content["effects"] = [data.draw(st.sampled_from(EFFECT_ENTRIES))]
    path, out = identified / "m.json", identified / "o.csv"
    commanded(
        data.draw(mutated(content)),
        path,
        lambda path: ["predict", path, identified / "short.csv", "-o", out],
        out,
    )


@settings(max_examples=80)
@given(data=st.data())
def test_a_mutated_sidecar_is_read_or_refused(identified, two_link, data):
    content = {
        "schema": "excite.recording/1",
        "period": 5.2,
        "periodic": [0.0, 15.6],
        "motor_side": True,
        "drive_gain": {"joint_1": 2.0},
        "effort": "torque",
        "topic": "/joint_states",
        "notes": "n",
    }
    recording = identified / "side.csv"
    if not recording.exists():
        recording.write_bytes((identified / "short.csv").read_bytes())
    tried(
        data.draw(mutated(content)),
        recording.with_suffix(".json"),
        lambda _: recordings.read(recording, two_link),
    )


LIMITS = {
    "joints": {
        "joint_1": {"position": [-3.0, 3.0], "velocity": 3.0, "torque": 60, "jerk": 200.0},
        "joint_2": {
            "position": [-2.0, 2.0],
            "braking": {"offset": 0.2, "rate": 7.0, "stop": [-2.1, 2.1]},
        },
    },
    "margin": {"velocity": 0.05, "torque": 0.1},
}
MOVEIT = {
    "joint_limits": {
        "joint_1": {
            "has_position_limits": True,
            "min_position": -1.0,
            "max_position": 1.5,
            "has_velocity_limits": True,
            "max_velocity": 1.25,
            "has_jerk_limits": False,
            "max_jerk": 0,
        },
        "joint_2": {"has_effort_limits": True, "max_effort": 20.0},
    }
}
SCENE = {
    "floor": -0.9,
    "clearance": 0.02,
    "box": [
        {
            "name": "table",
            "size": [1.0, 0.5, 0.05],
            "position": [3.0, 0.0, 0.0],
            "rotation": [0.0, 0.0, 0.1],
            "ignore": ["base_link"],
        }
    ],
    "sphere": [{"radius": 0.1, "link": "link_2", "position": [0.1, 0.0, 0.0]}],
    "capsule": [{"radius": 0.1, "length": 0.3, "position": [0.0, 4.0, 0.0]}],
}
PRIOR = {
    "schema": "excite.prior/1",
    "trust_prior": True,
    "joints": {
        "joint_1": {"coulomb": 1.3, "viscous": 0.4, "rotor_inertia": 0.4, "offset": 0.1},
        "joint_2": {"coulomb": 0.4},
    },
    "notes": "n",
}
BOUNDS = {
    "links": {
        "link_1": {"mass": [0.5, 9.0], "centre": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]},
        "link_2": {"mass": [0.5, 9.0]},
    }
}


def arrays_are_finite_or_absent(resolved: limits.Limits) -> None:
    for quantity in ("velocity", "torque"):
        assert (getattr(resolved, quantity) > 0.0).all()
        assert np.isfinite(getattr(resolved, quantity)).all()
    assert not np.isnan(resolved.position).any()


@settings(max_examples=150)
@given(text=mutated(LIMITS, toml=True))
def test_a_mutated_limits_file_is_read_or_refused(two_link, tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "l.toml"
    tried(text, path, lambda path: arrays_are_finite_or_absent(limits.resolve(two_link, path)))


@settings(max_examples=150)
@given(text=mutated(MOVEIT))
def test_a_mutated_moveit_file_is_read_or_refused(two_link, tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "l.yaml"
    tried(text, path, lambda path: arrays_are_finite_or_absent(limits.resolve(two_link, path)))


@settings(max_examples=100)
@given(text=mutated(SCENE, toml=True))
def test_a_mutated_scene_is_used_or_refused(two_link, table, tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "s.toml"
    tried(text, path, lambda path: scene_file.build_cell(two_link, table, scene_file.read(path)))


@settings(max_examples=100)
@given(text=mutated(PRIOR))
def test_a_mutated_prior_is_read_or_refused(two_link, table, tmp_path_factory, text):
    standard = inertial_parameters.standard_parameters(two_link, table)
    path = tmp_path_factory.getbasetemp() / "p.json"

    def use(path: Path) -> None:
        known = prior.read_prior(path, two_link, standard)
        assert np.isfinite(list(known.parameters.values())).all()

    tried(text, path, use)


def identify_with_bounds(identified: Path, text: str) -> None:
    """Identify with a mutated file of bounds."""
    words = ("identify", "two_link", identified / "train.csv", "-o", identified / "bounded")
    commanded(text, identified / "b.toml", lambda path: [*words, "--bounds", path])


@settings(max_examples=15)
@given(text=mutated(BOUNDS, toml=True))
def test_mutated_bounds_are_used_or_refused(identified, text):
    identify_with_bounds(identified, text)


@pytest.mark.slow
@settings(max_examples=60)
@given(text=mutated(BOUNDS, toml=True))
def test_more_mutated_bounds_are_used_or_refused(identified, text):
    identify_with_bounds(identified, text)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the ground truth of a simulated recording."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("simulated")
    words = ("simulate", "two_link", TWO_LINK, "--periods", "1")
    effect = ("--effect", "stribeck:joint_1", "-o", folder / "r.csv")
    assert run(*words, *effect).code == 0
    return folder


@settings(max_examples=60)
@given(data=st.data())
def test_a_mutated_truth_is_simulated_or_refused(simulated, data):
    content = json.loads((simulated / "r.truth.json").read_text(encoding="utf-8"))
    used = ("schema", "joints", "bodies", "setting", "effects")
    out = simulated / "o.csv"
    words = ("simulate", "two_link", TWO_LINK, "--periods", "1", "-o", out)
    commanded(
        data.draw(mutated({key: content[key] for key in used})),
        simulated / "like.json",
        lambda path: [*words, "--like", path],
        out,
    )


def test_mutations_change_the_document():
    """TOML texts without mutations are read back as the document; with mutations they differ."""
    from document_mutations import in_json, in_toml

    assert tomllib.loads(in_toml(LIMITS)) == LIMITS and json.loads(in_json(SCENE)) == SCENE


# -- the effects of a model ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tracks() -> list[recorded_motion.RecordedMotion]:
    """Two motions of a two-link robot with temperatures."""
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    whole_recording = synthetic_recording(subject, psi, random_fourier(2, 1), 3.0, 0.1)
    warm = np.outer(np.linspace(20.0, 40.0, len(whole_recording.t)), [1.0, 1.2])
    recording = replace(whole_recording, temperature=warm)
    done = identification.identify(
        subject.robot,
        subject.parameters,
        subject.base,
        [recording],
        [recording],
        identification.IdentificationOptions(band=20.0),
        lambda _: None,
    )
    pieces = list(segments.extract_segments([recording], average=False))
    return recorded_motion.recorded_motions(done.model, done.psi, pieces, 20.0)


def variants(shape: CandidateModel) -> Iterator[CandidateModel]:
    """Return a candidate model and its variants."""
    yield shape
    for near in shape.variants():
        yield near.current


def dense_models(effect: Effect, tracks: Sequence[RecordedMotion]) -> list[CandidateModel]:
    """Return the models of an effect that a diagnosis fits or seeks in the residual."""
    if effect.name == "torque_ripple":
        return [torque_ripple.wave_model(tracks, 1, 17.3)]
    if effect.name == "contact":
        return list(contact.contact_models(tracks, 0, 1.0, 2.0, 1.0))
    return [m for m in joint_model.dense_models(tracks) if m.effect == effect.name]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_candidate_model_of_the_catalogue_fits_its_schema(effect, tracks, subject):
    """Every form of an effect is written to a model and read back."""
    file = DocumentFile(Path("model.json"), "a model", "diagnose again", "a model.json")
    forms: set[tuple[frozenset[str], float | None]] = set()
    for shape in (*effect.candidates(tracks), *dense_models(effect, tracks)):
        for variant in variants(shape):
            form = (
                frozenset(variant.values),
                variant.values.get("form", variant.values.get("way", variant.values.get("count"))),
            )
            if form in forms:
                continue
            forms.add(form)
            count = variant.columns(tracks[0]).shape[2]
            part = fitted_effects.FittedEffect(variant, np.full(count, 0.5))
            entry = json.loads(json.dumps(fitted_effects.entry(part, subject.robot)))
            again = fitted_effects.restored(file.converted(entry, EffectDocument), subject.robot)
            assert again.shape.values == dict(variant.values)
            assert (again.shape.joint, again.shape.other) == (variant.joint, variant.other)
            entry["coefficients"].append(0.5)
            with pytest.raises(UnusableInput, match="coefficients: "):
                file.converted(entry, EffectDocument)
    assert forms


def test_one_bound_of_a_range_is_refused():
    entry = {"effect": "position_friction", "joint": "joint_1", "from": None, "coefficients": [0.1]}
    values = {"order": 1.0, "waves": 1.0, "low": 0.0}
    file = DocumentFile(Path("model.json"), "a model", "diagnose again", "a model.json")
    with pytest.raises(UnusableInput, match="high"):
        file.converted({**entry, "values": values, "time": None, "recording": None}, EffectDocument)

"""The commands `excite identify` and `excite predict`, and their error messages."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import states, text_of
from synthetic_recordings import (
    perturbed_parameters,
    random_fourier,
    rest_to_rest,
    synthetic_recording,
    two_link_model,
    write_recording,
)

from excite.cli import main as main_module
from excite.identification import consistency, identified_model
from excite.robot import dynamics, inertial_parameters, limits, robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of a two-link robot that differs from its URDF, and the identified model."""
    folder = tmp_path_factory.mktemp("identify")
    subject = two_link_model()
    psi = perturbed_parameters(subject.parameters, np.random.default_rng(4))
    for name, seed in (("train", 2), ("other", 5)):
        write_recording(
            synthetic_recording(subject, psi, random_fourier(2, seed), 3, 0.2),
            folder / f"{name}.csv",
        )
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--validate",
            folder / "other.csv",
            "-o",
            folder / "out",
        )
        == 0
    )
    return folder


def run(*words: object) -> int:
    return main_module.main([str(word) for word in words])


def error_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a command that fails with wrong input, and return its error message."""
    capsys.readouterr()
    assert run(*words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return next(line for line in err.splitlines() if line.startswith("excite:"))


def test_the_files_and_the_json_output_agree(folder, capsys):
    capsys.readouterr()
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--validate",
            folder / "other.csv",
            "-o",
            folder / "again",
            "--json",
        )
        == 0
    )
    document = json.loads(capsys.readouterr().out)
    stored = json.loads((folder / "again" / "model.json").read_text())
    assert (
        document["schema"] == stored["schema"] == "excite.model/1"
        and document["base_parameters"] == stored["base_parameters"]
    )
    assert {Path(name).name for name in document["files"]} == {
        "model.json",
        "identified.urdf",
        "report.html",
    }
    errors = stored["validation"][0]["joints"]
    assert all(
        row["rmse"] < 0.5 * row["rmse_nominal"] and row["noise_floor"] > 0
        for row in errors.values()
    )
    for parameter in stored["base_parameters"]:
        if parameter["interval"] is not None:
            assert parameter["interval"][0] < parameter["data"] < parameter["interval"][1]


def test_a_model_that_is_worse_than_the_nominal_robot_is_remarked(folder, capsys, tmp_path):
    subject = two_link_model()
    nominal = consistency.consistent_nominal(subject.parameters)
    recording = synthetic_recording(subject, nominal, random_fourier(2, 6), 3, 0.2)
    path, train = write_recording(recording, tmp_path / "nominal.csv"), folder / "train.csv"
    for held_out, is_worse in ((path, True), (folder / "other.csv", False)):
        capsys.readouterr()
        assert run("identify", "two_link", train, "--validate", held_out, "-o", tmp_path) == 0
        text, report = capsys.readouterr().out, (tmp_path / "report.html").read_text()
        assert ("joint_1 and joint_2: the nominal robot predicts" in text) is is_worse
        assert ("The nominal robot predicts joint_1 and joint_2 better" in report) is is_worse
        assert "check the units" not in text


def test_a_recording_with_few_equations_is_refused_or_remarked(folder, capsys, tmp_path):
    """So few equations fit the noise; those of some more can be worse than nominal."""
    subject = two_link_model()
    nominal = consistency.consistent_nominal(subject.parameters)
    recording = synthetic_recording(subject, nominal, random_fourier(2, 6), 3, 0.2)
    held_out = write_recording(recording, tmp_path / "nominal.csv")
    lines = (folder / "train.csv").read_text().splitlines(keepends=True)
    short, output = tmp_path / "short.csv", tmp_path / "out"
    arguments = ("identify", "two_link", short, "--validate", held_out, "--band", 8, "-o", output)
    short.write_text("".join(lines[:1191]))
    line = error_line(capsys, *arguments)
    assert "16 equations are too few for 15 parameters and the noise of 2 joints" in line
    assert not output.exists()
    short.write_text("".join(lines[:1251]))
    assert run(*arguments) == 0
    assert "20 equations are few for 13 parameters: record for longer" in capsys.readouterr().out


def test_what_looks_like_a_delay_of_the_torque_may_be_friction(folder, capsys, tmp_path):
    rows = (folder / "train.csv").read_text().splitlines()
    cells = np.array([row.split(",") for row in rows])
    torque = np.char.startswith(cells[0], "tau.")
    cells[3:, torque] = cells[1:-2, torque]
    (tmp_path / "late.csv").write_text("\n".join(map(",".join, cells)) + "\n")
    assert run("identify", "two_link", tmp_path / "late.csv", "-o", tmp_path / "out") == 0
    (line,) = (x for x in capsys.readouterr().out.splitlines() if "position on average" in x)
    assert re.search(r" [34](\.\d+)? ms after position", line) and "friction that builds up" in line


def test_torque_is_predicted_at_the_times_of_the_recording(folder):
    assert (
        run(
            "predict", folder / "out" / "model.json", folder / "other.csv", "-o", folder / "tau.csv"
        )
        == 0
    )
    predicted = np.genfromtxt(folder / "tau.csv", delimiter=",", names=True, deletechars="")
    measured = np.genfromtxt(folder / "other.csv", delimiter=",", names=True, deletechars="")
    assert np.allclose(predicted["t"], measured["t"])
    for joint in ("joint_1", "joint_2"):
        inner = slice(300, -300)
        left = predicted[f"tau.{joint}"][inner] - measured[f"tau.{joint}"][inner]
        assert np.sqrt(np.mean(left**2)) < 0.35


def test_torque_is_predicted_at_unix_times(folder, tmp_path):
    header, *rows = (folder / "other.csv").read_text(encoding="utf-8").splitlines()
    stamps = [f"{1_765_000_000.25 + 0.002 * k:.3f}" for k in range(len(rows))]
    shifted = [",".join([t, *row.split(",")[1:]]) for t, row in zip(stamps, rows, strict=True)]
    recording, predicted = tmp_path / "unix.csv", tmp_path / "tau.csv"
    recording.write_text("\n".join([header, *shifted]) + "\n", encoding="utf-8")
    assert run("predict", folder / "out" / "model.json", recording, "-o", predicted) == 0
    lines = predicted.read_text(encoding="utf-8").splitlines()[1:]
    assert [float(line.split(",")[0]) for line in lines] == [float(t) for t in stamps]


@pytest.mark.parametrize(
    ("first", "last", "times"),
    [(0, 701, None), (100, 601, None), (350, 701, "1.4 s"), (0, 350, "1.396 s")],
)
def test_a_prediction_warns_of_ends_in_motion(folder, tmp_path, capsys, first, last, times):
    share = np.clip(np.linspace(-0.2, 1.2, 701), 0.0, 1.0)
    rising = rest_to_rest(share)
    noise = np.random.default_rng(1).normal(scale=1e-5, size=701)  # of a joint that is held
    table = np.column_stack([0.004 * np.arange(701), rising, noise])[first:last]
    path = tmp_path / "motion.csv"
    np.savetxt(path, table, "%.7f", delimiter=",", header="t,q.joint_1,q.joint_2", comments="")
    assert run("predict", folder / "out" / "model.json", path, "-o", tmp_path / "tau.csv") == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "in motion" in line]
    if times is None:
        assert lines == []
    else:
        (line,) = lines
        assert f"motion.csv: begins or ends in motion at {times}; " in line


def test_the_identified_urdf_gives_the_torque_of_the_model(folder):
    fitted = identified_model.read_model(folder / "out" / "model.json")
    again = robot.load(str(folder / "out" / "identified.urdf"))
    standard = inertial_parameters.standard_parameters(again, limits.resolve(again))
    samples = states(2)
    assert np.allclose(standard.nominal, fitted.psi, rtol=1e-9, atol=1e-12)
    assert np.allclose(
        dynamics.regressor(again, standard, samples) @ standard.nominal,
        dynamics.regressor(again, standard, samples) @ fitted.psi,
    )


def test_the_identified_urdf_keeps_comments_and_fixes_locked_joints(tmp_path):
    """A locked joint becomes fixed where it was locked; links behind it move with its parent."""
    from excite.identification.urdf_export import identified_urdf

    machine = robot.load("ur10e", lock={"wrist_2_joint": 0.7, "wrist_3_joint": -0.3})
    table = limits.resolve(machine)
    standard = inertial_parameters.standard_parameters(machine, table)
    psi = perturbed_parameters(standard, np.random.default_rng(1))
    path = tmp_path / "identified.urdf"
    path.write_text(identified_urdf(machine, standard, psi, np.full(machine.n, 0.003)))
    assert path.read_text().count("<!--") == text_of("ur10e").count("<!--")
    again = robot.load(str(path))
    assert again.joints == machine.joints
    exported = inertial_parameters.standard_parameters(again, limits.resolve(again))
    samples = states(machine.n)
    before, after = (
        dynamics.regressor(machine, standard, samples) @ psi,
        dynamics.regressor(again, exported, samples) @ exported.nominal,
    )
    assert np.allclose(before, after, rtol=1e-9, atol=1e-9)


def test_a_recording_is_fitted_once(folder, capsys, tmp_path):
    copy = tmp_path / "copy.csv"
    copy.write_bytes((folder / "train.csv").read_bytes())
    words = ("identify", "two_link", folder / "train.csv", copy, "-o", tmp_path / "out")
    assert error_line(capsys, *words).endswith("and would count twice; name it once")


def test_priors_and_bounds_are_respected(folder):
    bounds = folder / "bounds.toml"
    bounds.write_text("[links.link_2]\nmass = [2.2, 2.4]\n")
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--bounds",
            bounds,
            "-o",
            folder / "bounded",
        )
        == 0
    )
    assert 2.2 <= identified_model.read_model(folder / "bounded" / "model.json").psi[10] <= 2.4
    prior = folder / "prior.json"
    prior.write_text(
        json.dumps(
            {
                "schema": "excite.prior/1",
                "trust_prior": True,
                "joints": {"joint_1": {"coulomb": 1.25}},
            }
        )
    )
    assert (
        run(
            "identify", "two_link", folder / "train.csv", "--prior", prior, "-o", folder / "trusted"
        )
        == 0
    )
    fitted = identified_model.read_model(folder / "trusted" / "model.json")
    machine = robot.load("two_link")
    standard = inertial_parameters.standard_parameters(machine, limits.resolve(machine))
    assert np.allclose(
        fitted.psi[:20], consistency.consistent_nominal(standard)[:20], rtol=1e-3, atol=1e-4
    )
    assert fitted.psi[standard.block("coulomb")][0] == pytest.approx(1.25, rel=1e-3)
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--prior",
            folder / "out" / "model.json",
            "-o",
            folder / "same",
        )
        == 0
    )


def test_effects_of_a_prior_are_left_out_with_a_warning(folder, capsys, tmp_path):
    model = json.loads((folder / "out" / "model.json").read_text())
    drag = {"effect": "drag", "joint": model["joints"][0], "values": {}, "coefficients": [0.1]}
    drag |= {"from": None, "time": None, "recording": None}
    path = tmp_path / "model.json"
    path.write_text(json.dumps({**model, "effects": [drag]}))
    words = ("identify", "two_link", folder / "train.csv", "--prior", path, "-o", tmp_path / "out")
    assert run(*words) == 0
    assert f"warning: {path}: has effects" in capsys.readouterr().err


def test_a_model_of_other_parameters_or_another_robot_is_refused_as_prior(folder, capsys, tmp_path):
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--without",
            "offset",
            "-o",
            tmp_path / "less",
        )
        == 0
    )
    words = ("identify", "two_link", folder / "train.csv", "-o", tmp_path / "out", "--prior")
    assert "expected rotor_inertia, viscous, coulomb, offset; identify with" in error_line(
        capsys, *words, tmp_path / "less" / "model.json"
    )
    longer = json.loads((folder / "out" / "model.json").read_text())
    moved = re.sub(
        r'(<joint name="joint_2".*?<origin xyz=")[^"]*',
        r"\g<1>0.7 0 0",
        longer["urdf"],
        flags=re.DOTALL,
    )
    assert moved != longer["urdf"]
    (tmp_path / "longer.json").write_text(json.dumps({**longer, "urdf": moved}))
    assert "is a model of another robot" in error_line(capsys, *words, tmp_path / "longer.json")


def test_a_training_recording_is_refused_for_validation(folder, capsys, tmp_path):
    train = folder / "train.csv"
    assert "is the same motion as" in error_line(
        capsys, "identify", "two_link", train, "--validate", train, "-o", tmp_path / "out"
    )


@pytest.mark.parametrize("estimator", ["ols", "full", "huber"])
def test_every_estimator_runs(folder, estimator):
    out = folder / estimator
    assert (
        run(
            "identify",
            "two_link",
            folder / "train.csv",
            "--estimator",
            estimator,
            "--distance",
            "riemannian",
            "-o",
            out,
        )
        == 0
    )
    assert json.loads((out / "model.json").read_text())["method"] == estimator


@pytest.mark.slow
def test_the_conic_check_of_a_refined_model_applies_to_its_start(folder):
    """Refined parameters no longer minimise the objective of the conic solver."""
    pytest.importorskip("cvxpy")
    out = folder / "refined"
    assert (
        run("identify", "two_link", folder / "train.csv", "--refine", "--check-lmi", "-o", out) == 0
    )
    assert json.loads((out / "model.json").read_text())["lmi"]["agrees"]


def test_a_design_can_complement_earlier_recordings(folder, capsys, tmp_path):
    """The new motion need not excite what earlier recordings did; the validation motion does."""
    quick = ("--starts", "1", "--iterations", "15", "--harmonics", "3", "--samples", "60")
    given = ("--given", folder / "train.csv")
    assert (
        run("design", "two_link", *quick, *given, "--validation", "--json", "-o", tmp_path / "next")
        == 0
    )
    values = json.loads(capsys.readouterr().out)["validation"]["criterion"]
    assert values["second"] < 2.0 * values["first"]


def test_unusable_input_gives_one_line_with_the_remedy(folder, capsys, tmp_path):
    train, out = folder / "train.csv", tmp_path / "none"
    go = ("identify", "two_link", train, "-o", out)
    cases = {
        ("identify", "two_link", folder / "absent.csv", "-o", out): "absent.csv",
        (*go, "--band", "-3"): "--band: -3 should be a number from 0.001",
        (*go, "--band", "400"): "half of the recording's rate",
        (*go, "--gamma", "much"): "--gamma",
        (*go, "--gamma", "0"): "from 1e-12",
        (*go, "--window", "0,1"): "--period",
        (*go, "--period", "1000"): "shorter than the recording",
        (*go, "--prior", folder / "train.csv"): "prior",
        (*go, "--bounds", folder / "absent.toml"): "absent.toml",
        ("predict", folder / "train.json", train, "-o", tmp_path / "x.csv"): "excite.model/1",
        ("predict", folder / "absent.json", train, "-o", tmp_path / "x.csv"): "absent.json",
        (
            "predict",
            folder / "out" / "model.json",
            folder / "train.json",
            "-o",
            tmp_path / "x.csv",
        ): "write the rows that it holds as CSV",
    }
    for words, part in cases.items():
        assert part in error_line(capsys, *words), words
    assert not out.exists() and not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[links.nobody]\nmass = [1, 2]\n", "no moving link 'nobody'"),
        (
            "[links.link_2]\nmass = [3, 2]\n",
            "links.link_2.mass: the lower bound 3 is not below the upper bound 2",
        ),
        (
            "[links.link_2]\ncentre = [1, 2, 3]\n",
            "links.link_2.centre: should hold 2 values, not 3",
        ),
        ("links", "cannot be read as bounds"),
        ("[links.link_2]\ncenter = [[0, 0, 0], [1, 1, 1]]\n", "unknown key 'center'"),
        ("[joints.joint_1]\nmass = [1, 2]\n", "has the unknown key 'joints'; it may have links"),
        ("[links]\nlink_2 = 3\n", "links.link_2: 3 should be a table"),
    ],
)
def test_unusable_bounds_are_refused(folder, capsys, tmp_path, text, part):
    path = tmp_path / "bounds.toml"
    path.write_text(text)
    assert part in error_line(
        capsys,
        "identify",
        "two_link",
        folder / "train.csv",
        "--bounds",
        path,
        "-o",
        tmp_path / "out",
    )


@pytest.mark.parametrize(
    ("stated", "part"),
    [
        ({"schema": "excite.prior/2"}, "excite.prior/2"),
        ({"trust_prior": False}, "trust_prior"),
        ({"joints": {"elbow": {}}}, "no joint 'elbow'"),
        ({"joints": None}, "joints: null should be a table"),
        ({"joints": {"joint_1": 0.3}}, "joints.joint_1: 0.3 should be a table"),
        (
            {"joints": {"joint_1": {"backlash": 1}}},
            "joints.joint_1: has the unknown key 'backlash'",
        ),
        (
            {"joints": {"joint_1": {"coulomb": "much"}}},
            "joints.joint_1.coulomb: 'much' should be a number",
        ),
        ({"joint": {"joint_1": {"coulomb": 1.25}}}, "has the unknown key 'joint'"),
    ],
)
def test_unusable_priors_are_refused(folder, capsys, tmp_path, stated, part):
    path = tmp_path / "prior.json"
    path.write_text(json.dumps({"schema": "excite.prior/1", "trust_prior": True, **stated}))
    assert part in error_line(
        capsys,
        "identify",
        "two_link",
        folder / "train.csv",
        "--prior",
        path,
        "-o",
        tmp_path / "out",
    )


def test_a_recording_shorter_than_the_margins_of_the_filter_is_refused(folder, capsys, tmp_path):
    lines = (folder / "train.csv").read_text().splitlines()
    path = tmp_path / "short.csv"
    path.write_text("\n".join(lines[:100]) + "\n")
    assert "stretch" in error_line(capsys, "identify", "two_link", path, "-o", tmp_path / "out")


def test_missing_drive_gains_of_all_recordings_are_named_at_once(folder, tmp_path, capsys):
    for name in ("train", "other"):
        text = (folder / f"{name}.csv").read_text().replace("tau.joint", "i.joint")
        (tmp_path / f"{name}.csv").write_text(text)
    words = ("identify", "two_link", tmp_path / "train.csv", "--validate", tmp_path / "other.csv")
    line = error_line(capsys, *words, "-o", tmp_path / "out")
    for part in ("train.csv", "other.csv", "train.json", "other.json", '"joint_2": N m/A'):
        assert part in line

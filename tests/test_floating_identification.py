"""Identification of floating-base robots from simulated and real recordings."""

from __future__ import annotations

import json

import numpy as np
import pytest
from floating_base_fixtures import HUMAN, biped_urdf, motion_csv, needs_human

from excite.api import (
    identify_floating,
    load_floating_robot,
    predict,
    read_floating_recording,
    simulate_floating,
)
from excite.cli.main import main
from excite.errors import UnusableInput
from excite.identification import estimators, floating_identification, floating_regression
from excite.identification.consistency import is_consistent
from excite.identification.estimators import Method
from excite.identification.floating_regression import FloatingModel, about_base_origin
from excite.identification.symmetry import symmetry_root
from excite.robot import floating_base
from excite.robot.floating_base import Rows
from excite.robot.inertial_parameters import COULOMB_WIDTH

FEET = ("left_shank", "right_shank")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("biped")
    (out / "biped.urdf").write_text(biped_urdf(drive=True), encoding="utf-8")
    for name, seed in (("motion", 0), ("other", 1)):
        (out / f"{name}.csv").write_text(motion_csv(seed=seed), encoding="utf-8")
    urdf = out / "biped.urdf"
    for name, motion in (("plate", "motion"), ("validation", "other")):
        simulate_floating(urdf, out / f"{motion}.csv", seed=3, model_error=0.1).save(
            out / f"{name}.csv"
        )
        simulate_floating(urdf, out / f"{motion}.csv", contacts=FEET, seed=3, model_error=0.1).save(
            out / f"{name}_feet.csv"
        )
    return out


@pytest.fixture(scope="module")
def plate(folder):
    return identify_floating(
        folder / "biped.urdf", [folder / "plate.csv"], validate=[folder / "validation.csv"]
    )


@pytest.fixture(scope="module")
def feet(folder):
    """Identification from wrenches under both feet and joint torques."""
    return identify_floating(
        folder / "biped.urdf",
        [folder / "plate_feet.csv"],
        validate=[folder / "validation_feet.csv"],
        gamma=10.0,
    )


def test_the_wrench_of_another_motion_is_predicted(plate):
    prediction = plate.identification.validations[0]
    assert (prediction.error() < 0.5 * prediction.error("nominal")).all()
    assert is_consistent(plate.identification.model.parameters, plate.identification.psi)
    assert plate.identification.model.rows is Rows.BASE


@pytest.mark.slow
def test_gamma_is_chosen_on_the_training_recordings_alone(folder, plate):
    alone = identify_floating(folder / "biped.urdf", [folder / "plate.csv"])
    assert alone.identification.gamma_trials == plate.identification.gamma_trials
    assert np.array_equal(alone.identification.psi, plate.identification.psi)
    trials = dict(plate.identification.gamma_trials)
    assert trials[plate.identification.prior.inertial_weight] == min(trials.values())


def test_both_rows_identify_bodies_and_friction(feet):
    result = feet.identification
    assert result.model.rows is Rows.BOTH
    prediction = result.validations[0]
    assert (prediction.error()[:6] < 0.6 * prediction.error("nominal")[:6]).all()
    parameters = result.model.parameters
    for kind, value in (("viscous", 0.3), ("coulomb", 0.5)):
        estimate = result.psi[parameters.block(kind)]
        deviation = np.sqrt(np.diag(result.posterior.covariance))[parameters.block(kind)]
        assert (np.abs(estimate - value) < 4.0 * deviation).all()


def test_joint_rows_alone_do_not_see_the_base(folder):
    result = identify_floating(
        folder / "biped.urdf", [folder / "plate_feet.csv"], rows="joints", gamma=10.0
    ).identification
    shares = result.body_shares()
    assert shares["trunk"] < 0.01 < max(shares.values())


def test_the_offset_of_a_sensor_is_estimated(folder):
    offset = (4.0, -3.0, 0.0, 0.5, -0.4, 0.3)
    simulate_floating(
        folder / "biped.urdf", folder / "motion.csv", seed=3, offset={"world": offset}
    ).save(folder / "offset.csv")
    result = identify_floating(
        folder / "biped.urdf", [folder / "offset.csv"], gamma=10.0
    ).identification
    error = np.abs(result.offset - offset)
    assert (error[[0, 1, 3, 4, 5]] < 4.0 * result.offset_deviation[[0, 1, 3, 4, 5]]).all()
    without = identify_floating(
        folder / "biped.urdf", [folder / "offset.csv"], gamma=10.0, offsets=False
    ).identification
    assert not len(without.offset)
    assert without.weights.deviation[0] > result.weights.deviation[0]


def test_intervals_cover_the_true_base_parameters(folder):
    """95 % intervals of the data alone, 12 recordings of 38 base parameters."""
    robot = load_floating_robot(folder / "biped.urdf")
    parameters = floating_base.standard_parameters(robot)
    base = floating_base.find_base_parameters(robot, parameters, Rows.BASE)
    widths = np.full(robot.n, COULOMB_WIDTH)
    model = FloatingModel(robot, parameters, base, Rows.BASE, ("world",), widths)
    motion = read_floating_recording(folder / "motion.csv", robot)
    covered = []
    for seed in range(12):
        simulated = simulate_floating(robot, motion, seed=seed, wrench_noise=(3.0, 0.3))
        path = folder / "covered.csv"
        path.write_text(simulated.csv(), encoding="utf-8")
        recording = read_floating_recording(path, robot)
        system = floating_regression.build_equations(model, [recording], np.full(6, 8.0))
        estimate = estimators.estimate(system.equations, Method.WLS, nuisance=system.offsets)
        half = estimators.interval_half_widths(estimate, np.eye(base.count))
        true = base.matrix @ list(simulated.truth["parameters"].values())[: parameters.count]
        finite = np.isfinite(half)  # the mass and a constant vertical force are one direction
        covered += list((np.abs(estimate.theta - true) <= half)[finite])
    assert len(covered) > 400
    assert 0.90 <= np.mean(covered) <= 0.985


def test_coloured_residuals_count_for_fewer_samples():
    rng = np.random.default_rng(0)
    white = rng.normal(size=20_000)
    assert floating_identification.samples_per_independent(white) == pytest.approx(1.0, abs=0.1)
    coloured = np.zeros(len(white))
    for k in range(1, len(white)):
        coloured[k] = 0.8 * coloured[k - 1] + white[k]
    expected = (1.0 + 0.8) / (1.0 - 0.8)
    assert floating_identification.samples_per_independent(coloured) == pytest.approx(
        expected, rel=0.25
    )


def test_each_row_gets_the_cutoff_of_its_own_content(folder):
    """A wrench stored below 2 Hz is not compared with a prediction up to 12 Hz."""
    from scipy import signal

    robot = load_floating_robot(folder / "biped.urdf")
    recording = read_floating_recording(folder / "plate.csv", robot)
    low = signal.butter(4, 0.8, fs=recording.rate, output="sos")
    recording.signals["wrench.world"][:, 0] = signal.sosfiltfilt(
        low, recording.wrench("world")[:, 0]
    )
    result = identify_floating(robot, [recording], gamma=10.0).identification
    assert result.hertz[0] < 2.0
    assert result.hertz[1] > 5.0


# -- symmetric bodies ------------------------------------------------------------------------------


def test_mirrored_nominal_bodies_have_no_distance_from_symmetry(folder):
    robot = load_floating_robot(folder / "biped.urdf")
    parameters = floating_base.standard_parameters(robot)
    root = symmetry_root(robot, parameters, "left_", "right_")
    assert root.shape == (20, parameters.count)
    assert np.allclose(root @ parameters.nominal, 0.0, atol=1e-9)
    changed = parameters.nominal.copy()
    place = 10 * parameters.links.index("left_thigh")
    changed[place : place + 10] *= 1.05  # a body 5 % heavier is about a standard deviation away
    assert np.linalg.norm(root @ changed) == pytest.approx(1.0, rel=0.5)


def test_symmetric_bodies_stay_nearer_to_each_other(folder):
    def difference(**choices):
        result = identify_floating(
            folder / "biped.urdf", [folder / "plate.csv"], gamma=3.0, **choices
        ).identification
        root = symmetry_root(result.model.robot, result.model.parameters, "left_", "right_")
        assert max(result.body_shares().values()) < 1.0
        return np.linalg.norm(root @ result.psi)

    assert difference(symmetric=("left_", "right_")) < 0.7 * difference()


@pytest.mark.parametrize(
    ("prefixes", "message"),
    [(("arm_", "right_"), "no link with a mass begins with 'arm_'"), (("left_", "r_"), "partner")],
)
def test_unknown_pairs_are_refused(folder, prefixes, message):
    with pytest.raises(UnusableInput, match=message):
        identify_floating(folder / "biped.urdf", [folder / "plate.csv"], symmetric=prefixes)


# -- files and command line ------------------------------------------------------------------------


def run(*words):
    return main([str(word) for word in words])


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
def test_the_saved_model_predicts_as_the_result_does(folder, plate):
    plate.save(folder / "model")
    predicted = predict(folder / "model" / "model.json", folder / "validation.csv")
    assert predicted.columns[0] == "wrench.world.fx"
    robot = plate.identification.model.robot
    recording = read_floating_recording(folder / "validation.csv", robot)
    assert np.allclose(predicted.time, recording.t)
    prediction = plate.identification.validations[0]
    inner = slice(len(recording) // 4, 3 * len(recording) // 4)
    about = about_base_origin(predicted.values, recording.base)
    times = (prediction.time > recording.t[inner][0]) & (prediction.time < recording.t[inner][-1])
    for row in range(6):
        expected = prediction.fitted[times, row]
        values = np.interp(prediction.time[times], predicted.time, about[:, row])
        assert np.allclose(values, expected, atol=0.02 * np.abs(expected).max())


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
def test_joint_torque_is_predicted_with_the_recorded_wrenches(folder, feet):
    feet.save(folder / "both")
    predicted = predict(folder / "both" / "model.json", folder / "validation_feet.csv")
    assert predicted.columns[6:] == tuple(
        f"tau.{joint}" for joint in ("left_hip", "left_knee", "right_hip", "right_knee")
    )
    robot = load_floating_robot(folder / "biped.urdf")
    measured = read_floating_recording(folder / "validation_feet.csv", robot).torque
    inner = slice(len(measured) // 4, 3 * len(measured) // 4)
    error = np.std((predicted.values[:, 6:] - measured)[inner], axis=0)
    assert (error < 0.2 * np.std(measured[inner], axis=0) + 0.5).all()


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
@pytest.mark.slow
def test_the_order_of_wrench_columns_does_not_matter(folder):
    header, *rows = (folder / "validation_feet.csv").read_text(encoding="utf-8").splitlines()
    backward = folder / "backward.csv"
    backward.write_text("\n".join(",".join(line.split(",")[::-1]) for line in (header, *rows)))
    files = (folder / "plate_feet.csv", folder / "validation_feet.csv", backward)
    result = identify_floating(
        folder / "biped.urdf", files[:1], validate=files[1:], gamma=10.0, offsets=True
    )
    first, second = result.identification.validations
    np.testing.assert_array_equal(first.fitted, second.fitted)
    result.save(folder / "ordered")
    model = folder / "ordered" / "model.json"
    expected = predict(model, files[1]).values
    np.testing.assert_array_equal(predict(model, backward).values, expected)
    document = json.loads(model.read_text(encoding="utf-8"))
    for key in ("contacts", "offsets"):
        document["floating_base"][key].reverse()  # as of a fit to columns in this order
    model.write_text(json.dumps(document), encoding="utf-8")
    np.testing.assert_allclose(predict(model, files[1]).values, expected, atol=1e-8)


def test_the_commands_write_their_files(folder, capsys):
    urdf, plate_csv = folder / "biped.urdf", folder / "plate.csv"
    out = folder / "cli"
    options = ("--floating", "--gamma", "10", "--symmetric", "left_:right_", "--json")
    assert run("identify", urdf, plate_csv, *options, "-o", out) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["floating_base"]["rows"] == "base"
    assert set(document["floating_base"]["body_shares"]) == set(document["links"])
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "With which bodies do the data decide?" in report and "trunk" in report
    assert run("predict", out / "model.json", plate_csv, "-o", folder / "p.csv") == 0
    assert (folder / "p.csv").read_text(encoding="utf-8").startswith("t,wrench.world.fx,")
    assert run("identifiability", urdf, plate_csv, "--floating", "-o", folder / "idf") == 0
    assert (folder / "idf" / "report.html").is_file()
    assert run("simulate", urdf, folder / "motion.csv", "--floating", "-o", folder / "s.csv") == 0
    truth = json.loads((folder / "s.truth.json").read_text(encoding="utf-8"))
    assert truth["contacts"] == ["world"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("identify", "{urdf}", "{motion}", "--floating"), "has no contact wrench"),
        (("identify", "{urdf}", "{plate}", "--floating", "--rows", "joints"), "has no torque"),
        (("identify", "{urdf}", "{plate}", "--rows", "base"), "--rows: is for a robot with"),
        (("identify", "{urdf}", "{plate}", "--floating", "--refine"), "--refine: is not available"),
        (("identify", "{urdf}", "{plate}", "--floating", "--symmetric", "x"), "LEFT:RIGHT"),
        (("identify", "{urdf}", "{plain}", "--floating"), "has no column 'base.x'"),
        (("identifiability", "{urdf}", "{plain}", "--floating"), "has no column 'base.x'"),
        (
            ("identifiability", "{urdf}", "{plate}", "--floating", "--trajectory", "x.json"),
            "--trajectory: is not available with --floating",
        ),
        (("identify", "{urdf}", "{plate}", "{feet}", "--floating"), "has the contacts"),
    ],
)
def test_faults_are_one_line_with_exit_code_2(folder, capsys, words, message):
    plain = folder / "plain.csv"
    lines = (folder / "motion.csv").read_text(encoding="utf-8").splitlines()
    plain.write_text(
        "\n".join(",".join([x.split(",")[0], *x.split(",")[8:]]) for x in lines), encoding="utf-8"
    )
    names = {
        "urdf": folder / "biped.urdf",
        "plain": plain,
        "motion": folder / "motion.csv",
        "plate": folder / "plate.csv",
        "feet": folder / "plate_feet.csv",
    }
    assert run(*(word.format(**names) for word in words), "-o", folder / "fault") == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert message in error and error.startswith("excite: ")


def test_other_commands_refuse_the_model_in_one_line(folder, plate, capsys):
    plate.save(folder / "refused")
    model = folder / "refused" / "model.json"
    assert run("export", model, "--format", "urdf", "-o", folder / "x.urdf") == 2
    assert "only 'excite predict' reads" in capsys.readouterr().err


# -- the recorded human ----------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
@needs_human
def test_the_wrench_of_the_human_is_predicted_below_the_baseline(tmp_path):
    """As scripts/human_wrench.py judges it, with γ of its cross-validation to save time."""
    from scipy import signal

    lines = (HUMAN / "motion.csv").read_text(encoding="utf-8").splitlines()
    judged = np.arange(60, len(lines) - 1 - 60, 2)
    held_out = judged[int(0.6 * len(judged)) :]
    cut = int(held_out[0])
    for name, part in (("training", lines[1 : 1 + cut]), ("held_out", lines[1 + cut :])):
        path = tmp_path / f"{name}.csv"
        path.write_text("\n".join([lines[0], *part]) + "\n", encoding="utf-8")
    result = identify_floating(HUMAN / "human.urdf", [tmp_path / "training.csv"], gamma=31.6)
    result.save(tmp_path / "model")
    values = predict(tmp_path / "model" / "model.json", tmp_path / "held_out.csv").values
    robot = result.identification.model.robot
    complete = read_floating_recording(HUMAN / "motion.csv", robot)
    low = signal.butter(4, 4.0, fs=30.0, output="sos")
    pose = signal.sosfiltfilt(low, complete.base, axis=0)
    measured = about_base_origin(signal.sosfiltfilt(low, complete.wrench("world"), axis=0), pose)
    error = measured[held_out] - about_base_origin(values, pose[cut:])[held_out - cut]
    rmse = np.sqrt(np.mean(error**2, axis=0))
    assert (rmse < [11.3, 23.4, 21.4, 5.9, 7.6, 2.9]).all()
    assert is_consistent(result.identification.model.parameters, result.identification.psi)


def test_a_recording_that_is_too_short_for_the_filter_is_named(folder):
    rows = (folder / "plate_feet.csv").read_text(encoding="utf-8").splitlines()
    short = folder / "short.csv"
    short.write_text("\n".join(rows[:21]) + "\n", encoding="utf-8")
    with pytest.raises(UnusableInput, match=r"short\.csv: no gap-free stretch is longer than"):
        identify_floating(folder / "biped.urdf", short, gamma=10.0, band=5.0)

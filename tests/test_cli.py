"""The command line: files, exit codes, and errors of one line."""

import json
import subprocess
import sys

import numpy as np
import pytest

import excite
from excite.cli import main as main_module
from excite.errors import UnusableInput
from excite.robot.robot import locate

MODELS = locate("two_link").parent
QUICK = ["--starts", "1", "--iterations", "15", "--harmonics", "3", "--samples", "60"]


def run(capsys, *arguments):
    code = main_module.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def refused(capsys, *arguments, code=2):
    """Return the one line that a refused command prints."""
    exit_code, out, err = run(capsys, *arguments)
    assert exit_code == code, err
    assert out == ""
    exit_code = [line for line in err.splitlines() if line.startswith("excite:")]
    assert len(exit_code) == 1, err
    return exit_code[0]


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("design")
    assert main_module.main(["design", "two_link", "-o", str(folder), *QUICK]) == 0
    return folder


def test_design_writes_its_four_files(designed):
    assert {p.name for p in designed.iterdir()} == {
        "trajectory.json",
        "trajectory.csv",
        "identifiability.json",
        "report.html",
    }


def test_csv_follows_the_contract(designed):
    header, *rows = (designed / "trajectory.csv").read_text().splitlines()
    assert header == "t," + ",".join(
        f"{q}.joint_{j}" for q in ("q", "dq", "ddq", "tau") for j in (1, 2)
    )
    table = np.array([row.split(",") for row in rows], float)
    assert np.allclose(table[:, 0], np.arange(len(table)) / 100.0, atol=1e-9)
    assert (table[[0, -1], 3:7] == 0.0).all()


def test_trajectory_json_has_the_contract_keys(designed):
    document = json.loads((designed / "trajectory.json").read_text())
    keys = "schema robot joints base_frequency harmonics period periods sine cosine offset segments"
    assert set(
        (
            keys + " rate limits torque_noise criterion criteria margins collision seed versions"
        ).split()
    ) <= set(document)
    assert document["schema"] == "excite.trajectory/1"
    assert {"kind", "start", "end"} <= set(document["segments"][0])


def test_identifiability_json_has_the_contract_keys(designed):
    document = json.loads((designed / "identifiability.json").read_text())
    assert set(
        [
            "schema",
            "threshold",
            "eigenvalues",
            "directions",
            "base_parameters",
            "links",
            "torque_noise",
        ]
    ) <= set(document)


def test_verify_states_the_smallest_distance(capsys, designed):
    code, out, _ = run(capsys, "verify", designed / "trajectory.json", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["ok"]
    assert "never less than" in document["collision"]
    assert {"limit", "joint", "time", "value", "bound"} <= set(document["margins"][0])


def test_design_json_carries_criteria_and_timing(capsys, tmp_path):
    code, out, _ = run(capsys, "design", "two_link", "-o", tmp_path / "o", "--json", *QUICK)
    document = json.loads(out)
    assert code == 0
    assert set(document["criteria"]["optimum"]) == {"geometric", "plain", "cond_regressor"}
    assert set(document["criteria"]["exported"]["geometric"]) == {"a", "d", "e", "cond"}
    assert set(["build", "first_feasible", "within_1_percent", "solve", "total"]) <= set(
        document["timing"]
    )


def test_a_trajectory_that_violates_limits_fails_verification_and_export(
    capsys, designed, tmp_path
):
    document = json.loads((designed / "trajectory.json").read_text())
    document["limits"]["velocity"]["joint_1"]["value"] *= 0.5
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps(document))
    assert run(capsys, "verify", broken)[0] == 1
    target = tmp_path / "out.csv"
    assert "velocity" in refused(capsys, "export", broken, "--format", "csv", "-o", target, code=1)
    assert not target.exists()
    assert (
        run(capsys, "export", broken, "--format", "ros2-joint-trajectory", "-o", target, "--force")[
            0
        ]
        == 0
    )
    assert "FORCED" in target.read_text()


@pytest.mark.parametrize(
    "form", ["csv", "json", "ros2-joint-trajectory", "ros2-follow-joint-trajectory"]
)
def test_export(capsys, designed, tmp_path, form):
    target = tmp_path / "file"
    code, _, err = run(
        capsys, "export", designed / "trajectory.json", "--format", form, "-o", target
    )
    assert code == 0, err
    assert target.stat().st_size > 1000


def test_identifiability_of_a_trajectory_and_of_a_recording_agree(capsys, designed, tmp_path):
    counts = []
    for motion in ("trajectory.json", "trajectory.csv"):
        code, out, err = run(
            capsys,
            "identifiability",
            "two_link",
            designed / motion,
            "-o",
            tmp_path / motion,
            "--json",
        )
        assert code == 0, err
        document = json.loads(out)
        counts.append(sum(d["identifiable"] for d in document["directions"]))
        assert (tmp_path / motion / "report.html").exists()
    assert abs(counts[0] - counts[1]) <= 1


@pytest.mark.parametrize("option", [("--columns", "t=clock"), ("--trajectory", "x.json")])
def test_options_of_recordings_are_refused_for_a_trajectory(capsys, designed, tmp_path, option):
    words = ("identifiability", "two_link", designed / "trajectory.json", *option)
    assert option[0] in refused(capsys, *words, "-o", tmp_path / "out")


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"columns": {"t": "clock"}}, "--columns"),
        ({"columns": {"t": "clock"}, "for_task": "x.json"}, "--columns"),
        ({"trajectory": "x.json", "for_task": "y.csv"}, "--trajectory"),
    ],
)
def test_designs_in_python_refuse_options_of_recordings_without_any(options, word):
    with pytest.raises(UnusableInput, match=word):
        excite.design("two_link", **options)


def test_identifiability_states_the_torque_noise_of_the_trajectory(capsys, tmp_path):
    noisy = ("--torque-noise", "16", "--no-collision", *QUICK)
    assert run(capsys, "design", "two_link", *noisy, "-o", tmp_path / "noisy")[0] == 0
    path = tmp_path / "noisy" / "trajectory.json"
    code, out, err = run(capsys, "identifiability", "two_link", path, "-o", tmp_path / "out")
    assert code == 0, err
    assert f"(torque noise of {path}, " in out


def test_torque_without_gravity_identifies_fewer_directions(capsys, designed, tmp_path):
    path, counts = tmp_path / "motion.csv", []
    path.write_bytes((designed / "trajectory.csv").read_bytes())
    for effort in ("torque", "without gravity"):
        stated = {"schema": "excite.recording/1", "effort": effort}
        path.with_suffix(".json").write_text(json.dumps(stated), encoding="utf-8")
        code, out, err = run(
            capsys, "identifiability", "two_link", path, "-o", tmp_path / "out", "--json"
        )
        assert code == 0, err
        counts.append(sum(d["identifiable"] for d in json.loads(out)["directions"]))
    assert counts[1] < counts[0]


@pytest.fixture(scope="module")
def validated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("validated")
    assert (
        main_module.main(
            ["design", "two_link", "-o", str(folder), "--validation", *QUICK, "--starts", "2"]
        )
        == 0
    )
    return folder


def test_the_validation_motion_is_certified_in_its_own_folder(capsys, validated):
    assert {p.name for p in (validated / "validation").iterdir()} == {
        "trajectory.json",
        "trajectory.csv",
    }
    assert run(capsys, "verify", validated / "validation" / "trajectory.json")[0] == 0
    first, second = (
        json.loads((folder / "trajectory.json").read_text())
        for folder in (validated, validated / "validation")
    )
    assert second["design"]["validates"] == "../trajectory.json"
    assert first["design"]["validation"] == second["design"]["validation"]
    assert first["sine"] != second["sine"] and first["seed"] == second["seed"]
    assert 'id="validation"' in (validated / "report.html").read_text()


def test_the_validation_motion_does_not_change_the_first(validated, tmp_path):
    assert (
        main_module.main(["design", "two_link", "-o", str(tmp_path), *QUICK, "--starts", "2"]) == 0
    )
    alone, first = (
        json.loads((folder / "trajectory.json").read_text()) for folder in (tmp_path, validated)
    )
    assert alone["sine"] == first["sine"] and "validation" not in alone["design"]


def test_validation_in_json(capsys, tmp_path):
    code, out, _ = run(
        capsys, "design", "two_link", "-o", tmp_path, "--validation", "--json", *QUICK
    )
    facts = json.loads(out)["validation"]
    assert (
        code == 0 and facts["ok"] and 0.0 <= facts["overlap"] < 1.0 and facts["independent"] is None
    )
    assert set(facts["torque_correlation"]) == {"joint_1", "joint_2"} and set(
        facts["criterion"]
    ) == {"first", "second"}
    assert {"criteria", "duration", "margins", "timing"} <= set(facts)


def test_time_budget_bounds_the_motion_and_lists_all_candidates(capsys, tmp_path):
    code, out, _ = run(
        capsys, "design", "two_link", "-o", tmp_path, "--time", "9", "--json", *QUICK[:4]
    )
    document = json.loads(out)
    keys = {
        "period",
        "harmonics",
        "samples",
        "repeats",
        "robot_time",
        "value",
        "deviation",
        "seconds",
    }
    assert code == 0 and document["duration"] <= 9.0
    assert all(set(c) == keys for c in document["plan"]["candidates"])
    assert 0 <= document["plan"]["chosen"] < len(document["plan"]["candidates"])
    stated = json.loads((tmp_path / "trajectory.json").read_text())["design"]
    assert "seconds" not in stated["plan"]["candidates"][0] and stated["chosen"] == [
        "period",
        "harmonics",
        "samples",
        "periods",
    ]
    assert 'id="plan"' in (tmp_path / "report.html").read_text()


def test_the_text_names_plan_and_validation(capsys, tmp_path):
    code, out, _ = run(
        capsys, "design", "two_link", "-o", tmp_path, "--time", "9", "--validation", *QUICK
    )
    assert code == 0
    assert "planned for 9 s: " in out and "validation: overlap 0." in out


def test_the_period_follows_from_the_limits(designed):
    document = json.loads((designed / "trajectory.json").read_text())
    assert document["period"] == 5.2 and document["design"]["chosen"] == ["period", "periods"]


def test_given_information_is_added(capsys, designed, tmp_path):
    code, _, err = run(
        capsys,
        "design",
        "two_link",
        "-o",
        tmp_path,
        "--given",
        designed / "trajectory.json",
        *QUICK,
    )
    assert code == 0, err
    assert json.loads((tmp_path / "trajectory.json").read_text())["design"]["given"] == [
        str(designed / "trajectory.json")
    ]


def test_speed_slows_the_motion(capsys, designed, tmp_path):
    code, _, err = run(capsys, "design", "two_link", "-o", tmp_path, "--speed", "0.5", *QUICK)
    assert code == 0, err
    slow, fast = (
        json.loads((folder / "trajectory.json").read_text()) for folder in (tmp_path, designed)
    )
    assert slow["period"] == pytest.approx(2.0 * fast["period"])


def test_robots_lists_models(capsys):
    _, out, _ = run(capsys, "robots", "--json")
    assert {"ur10e", "panda", "iiwa14", "tx40", "two_link"} <= {
        row["name"] for row in json.loads(out)["robots"]
    }


# -- bad input -------------------------------------------------------------------------------------

LINK = (
    '<inertial><mass value="1"/><origin xyz="0.1 0 0"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def write_urdf(
    folder, inertial=LINK, limit='lower="-1" upper="1" velocity="1" effort="10"', kind="revolute"
):
    path = folder / "robot.urdf"
    path.write_text(
        f'<robot name="r"><link name="base"/><link name="arm">{inertial}</link>'
        f'<joint name="elbow" type="{kind}"><parent link="base"/><child link="arm"/>'
        f'<axis xyz="0 1 0"/><limit {limit}/></joint></robot>'
    )
    return path


@pytest.mark.parametrize(
    ("inertial", "limit", "kind", "words"),
    [
        (LINK, 'lower="-1" upper="1" velocity="1"', "revolute", ("elbow", "torque", "--limits")),
        (LINK, 'lower="1" upper="-1" velocity="1" effort="10"', "revolute", ("elbow", "position")),
        (LINK, 'lower="-1" upper="1" velocity="0" effort="10"', "revolute", ("elbow", "velocity")),
        ("", 'lower="-1" upper="1" velocity="1" effort="10"', "revolute", ("elbow", "no mass")),
        (
            LINK.replace('"0.1"', '"nan"', 1),
            'lower="-1" upper="1" velocity="1" effort="10"',
            "revolute",
            ("arm", "not finite"),
        ),
        (LINK, 'lower="-1" upper="1" velocity="1" effort="10"', "fixed", ("no movable joint",)),
        (LINK, 'lower="-1" upper="1" velocity="1" effort="10"', "screw", ("elbow", "screw")),
        (
            LINK,
            'lower="-0.2" upper="0.2" velocity="1" effort="0.1"',
            "revolute",
            ("elbow", "gravity", "torque"),
        ),
    ],
    ids=[
        "no-torque",
        "inverted",
        "zero-velocity",
        "no-mass",
        "nan",
        "no-joint",
        "unknown-type",
        "below-gravity",
    ],
)
def test_bad_urdf(capsys, tmp_path, inertial, limit, kind, words):
    path = write_urdf(tmp_path, inertial, limit, kind)
    line = refused(capsys, "design", path, "-o", tmp_path / "out", *QUICK)
    for word in (str(path), *words):
        assert word in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "not valid XML"),
        ("<x/>", "not <robot>"),
        ('<robot xmlns:xacro="u"><xacro:a/></robot>', "xacro"),
    ],
)
def test_unreadable_urdf(capsys, tmp_path, text, words):
    path = tmp_path / "broken.urdf"
    path.write_text(text)
    assert words in refused(capsys, "design", path, "-o", tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.urdf"], ("nowhere.urdf", "no such file")),
        (["two_link", "--joints", "joint_9"], ("joint_9", "joint_1")),
        (["two_link", "--lock", "joint_1=0,", "--joints", "joint_2"], ("--lock",)),
        (["two_link", "--lock", "joint_1=nan"], ("--lock", "from -1e+06 to 1e+06 rad or m")),
        (["two_link", "--lock", "joint_1=0", "--lock", "joint_2=0"], ("locked",)),
        (["two_link", "--lock", "joint_2=99"], ("--lock joint_2=99", "limits of the joint")),
        (
            ["two_link", "--lock", "joint_2=0.3", "--lock", "joint_2=0.5"],
            ("--lock joint_2", "twice"),
        ),
        (
            ["two_link", "--payload", "tip:1", "--payload", "link_1:2"],
            ("--payload link_1", "one body"),
        ),
        (["two_link", "--period", "3.1415"], ("--period", "whole number of samples", "3.14")),
        (["two_link", "--period", "nan"], ("--period",)),
        (["two_link", "--start", "9,9"], ("start pose", "joint_1", "outside")),
        (["two_link", "--start", "0"], ("--start", "2")),
        (["two_link", "--time", "2"], ("--time 2", "too short", "at least --time")),
        (["two_link", "--time", "-3"], ("--time", "from 0.001 to 1e+06 s")),
        (["two_link", "--time", "20", "--optimise-period", "2,5"], ("--time", "--optimise-period")),
        (["two_link", "--harmonics", "0"], ("--harmonics", "from 1 to 100")),
        (["two_link", "--rate", "nan"], ("--rate", "from 0.001 to 100000 Hz")),
        (["two_link", "--threshold", "0"], ("--threshold", "from 1e-12")),
        (["two_link", "--jobs", "0"], ("--jobs", "not 0")),
        (["two_link", "--seed", "-1"], ("--seed", "whole number from 0")),
        (["two_link", "--harmonics", "40", "--samples", "60"], ("--samples", "harmonics")),
        (["two_link", "--periods", "1"], ("--periods", "2")),
        (["two_link", "--box", "tipp:0,1,0,1,0,1"], ("tipp", "tip")),
        (["two_link", "--box", "tip:1,0,0,1,0,1"], ("--box",)),
        (["two_link", "--torque-noise", "-1"], ("--torque-noise", "from 1e-09")),
        (["two_link", "--payload", "nolink:1"], ("nolink",)),
        (["two_link", "--payload", "tip:-1"], ("--payload", "from 0 to 1e+06 kg")),
        (["two_link", "--without", "nothing"], ("nothing", "viscous")),
        (["two_link", "--gravity", "0,0"], ("--gravity",)),
        (["two_link", "--criterion", "best"], ("--criterion",)),
        (["two_link", "--uncertainty", "-1"], ("--uncertainty",)),
        (["two_link", "--limits", "nowhere.toml"], ("nowhere.toml",)),
        (["two_link", "--given", "nowhere.json"], ("nowhere.json",)),
        (["two_link", "--columns", "t=clock"], ("--columns", "--given or --for")),
        (["two_link", "--columns", "t=clock", "--for", "x.json"], ("--columns", "--for")),
        (["two_link", "--columns", "t=clock", "--given", "x.json"], ("--columns", "--given")),
        (["two_link", "--trajectory", "x.json", "--for", "y.csv"], ("--trajectory", "--given")),
        (["two_link", "--trajectory", "x.json", "--given", "y.json"], ("--trajectory", "--given")),
        (["two_link", "--speed", "0"], ("--speed",)),
        (["two_link", "--speed", "nan"], ("--speed",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_wrong_use(capsys, tmp_path, arguments, words):
    line = refused(
        capsys,
        "design",
        *arguments,
        "-o",
        tmp_path / "out",
        *(o for o in QUICK if "--harmonics" not in arguments or o not in QUICK[4:]),
    )
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "ur10e", "t.json", "-o", "x.csv", "--foo"], ["--foo", "excite simulate"]),
        (["simulate", "--foo"], ["--foo", "excite simulate"]),
        (["verify", "t.json", "again.json"], ["again.json", "excite verify"]),
        (["export", "t.json", "-o", "x", "-z"], ["-z", "excite export"]),
        (
            ["diagnose", "ur10e", "a.csv", "--valdate", "b.csv", "-o", "x"],
            ["--valdate", "did you mean --validate?", "excite diagnose"],
        ),
        (
            ["payload", "ur10e", "--whit=a.csv", "-o", "x"],
            ["--whit=a.csv", "did you mean --with?", "excite payload"],
        ),
        (
            ["design", "ur10e", "-o", "x", "--criterion", "condd"],
            ["'condd'", "did you mean cond?", "excite design"],
        ),
        (["--json", "robots"], ["--json", "options stand behind the command", "excite"]),
        (["--foo"], ["--foo", "excite"]),
    ],
)
def test_unknown_options_refer_to_the_help_of_their_command(capsys, arguments, words):
    line = refused(capsys, *arguments)
    *words, command = words
    assert line.endswith(f"(see {command} --help)")
    assert all(word in line for word in words), line


def test_a_list_may_begin_with_a_negative_number_and_a_file_name_with_a_dash(capsys):
    code, out, _ = run(capsys, "check", "two_link", "--gravity", "-1,0,-9.7", "--json")
    assert code == 0 and json.loads(out)["robot"]["name"] == "two_link"
    assert refused(capsys, "check", "--", "--absent.urdf").startswith("excite: --absent.urdf: no ")


def test_contradictory_limits_file(capsys, tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text("[joints.joint_1]\nposition = [1.0, -1.0]\n")
    line = refused(capsys, "design", "two_link", "--limits", file, "-o", tmp_path / "out")
    assert "joint_1" in line
    assert str(file) in line
    assert "contradict" in line


def test_an_unreachable_box_is_infeasible_and_names_the_conflict(capsys, tmp_path):
    line = refused(
        capsys,
        "design",
        "two_link",
        "--box",
        "tip:5,6,5,6,5,6",
        "-o",
        tmp_path / "out",
        *QUICK,
        code=1,
    )
    assert "tip" in line
    assert "box" in line


@pytest.mark.parametrize(
    "text", ["", "{", "{}", '{"schema": "excite.trajectory/1"}', '{"schema": "other/1"}', "[1]"]
)
def test_unusable_trajectory(capsys, tmp_path, text):
    path = tmp_path / "t.json"
    path.write_text(text)
    assert str(path) in refused(capsys, "verify", path)


def test_a_changed_urdf_is_detected(capsys, tmp_path):
    path = write_urdf(tmp_path)
    assert run(capsys, "design", path, "-o", tmp_path / "out", *QUICK)[0] == 0
    path.write_text(path.read_text().replace('mass value="1"', 'mass value="2"'))
    assert "sha256" in refused(capsys, "verify", tmp_path / "out" / "trajectory.json")


def test_a_urdf_is_found_from_any_folder_and_requested_where_it_has_moved(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    path = write_urdf(tmp_path)
    assert run(capsys, "design", path.name, "-o", "out", *QUICK)[0] == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    trajectory = tmp_path / "out" / "trajectory.json"
    assert run(capsys, "verify", trajectory)[0] == 0
    path.rename(tmp_path / "moved.urdf")
    line = refused(capsys, "verify", trajectory)
    assert str(path) in line and "--robot" in line
    assert run(capsys, "verify", trajectory, "--robot", tmp_path / "moved.urdf")[0] == 0


def test_an_output_that_cannot_be_written(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot be written" in refused(
        capsys, "design", "two_link", "-o", tmp_path / "file", *QUICK
    )


@pytest.mark.parametrize(
    "text",
    [
        "t,q.joint_1\n0,1\n",
        "a,b\n1,2\n",
        "t,q.joint_1,q.joint_2\n" + "0,nan,0\n" * 20,
        "t,q.joint_1,q.joint_2\n" + "0,0,0\n" * 20,
    ],
)
def test_unusable_recording(capsys, tmp_path, text):
    path = tmp_path / "r.csv"
    path.write_text(text)
    assert str(path) in refused(capsys, "identifiability", "two_link", path, "-o", tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["design", "two_link", "-o", ""], "argument -o: '' is no value"),
        (["design", "two_link", "-o", "out", "--scene="], "argument --scene: '' is no value"),
        (["verify", ""], "'' is no value"),
        (["verify", "trajectory.json", "--robot", ""], "argument --robot: '' is no value"),
    ],
)
def test_an_empty_path_is_refused(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused(capsys, *arguments)
    assert not list(tmp_path.iterdir())


def test_as_a_program():
    result = subprocess.run(
        [sys.executable, "-m", "excite", "verify", "nowhere.json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("excite: nowhere.json")

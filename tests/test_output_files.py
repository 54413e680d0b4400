"""Output files: atomic replacement, links, modes, refusal of special files, killed processes."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import text_of
from diagnosis_cases import recording_of
from synthetic_recordings import write_recording

import excite
from excite._system.output_files import OutputFiles, output_files, output_folder
from excite.cli.main import main
from excite.errors import UnusableInput
from excite.robot.robot import locate

NAMES = ("main.json", "table.csv", "sub/main.json", "page.html")
SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


def contents(word: str, names: tuple[str, ...] = NAMES) -> dict[str, str]:
    return {name: f"{word} {name}" for name in names}


def words(folder: Path) -> dict[str, str]:
    """Return the first word of each file of the set that exists."""
    return {
        name: (folder / name).read_text().split()[0] for name in NAMES if (folder / name).exists()
    }


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Folder with the old set and with files of the user."""
    folder = tmp_path / "out"
    output_folder(folder, NAMES).replace(contents("old"))
    (folder / "mine" / "deep").mkdir(parents=True)
    (folder / "mine" / "deep" / "notes.txt").write_text("notes")
    (folder / "sub" / "other.txt").write_text("other")
    (folder / "empty").mkdir()
    (folder / "link").symlink_to("mine/deep")
    return folder


@pytest.fixture(params=["exchanged", "in place"])
def replaced(request: pytest.FixtureRequest, out: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, to be exchanged or written in place."""
    if request.param == "in place":
        monkeypatch.chdir(out)
    return out


# -- complete sets ---------------------------------------------------------------------------------


def test_missing_parent_folders_are_created(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b" / "out"
    written = output_folder(folder, NAMES).replace(contents("new"))
    assert written == [folder / name for name in NAMES]
    assert words(folder) == dict.fromkeys(NAMES, "new")
    assert everything(tmp_path) == {
        "a",
        "a/b",
        "a/b/out",
        *(f"a/b/out/{name}" for name in (*NAMES, "sub")),
    }


def test_other_files_of_the_folder_are_kept(replaced: Path) -> None:
    foreign = ("mine/deep/notes.txt", "sub/other.txt", "link")
    before = {name: os.lstat(replaced / name).st_ino for name in foreign}
    modified = os.stat(replaced / "mine").st_mtime_ns
    output_folder(replaced, NAMES).replace(contents("new"))
    assert words(replaced) == dict.fromkeys(NAMES, "new")
    assert {name: os.lstat(replaced / name).st_ino for name in foreign} == before
    assert os.stat(replaced / "mine").st_mtime_ns == modified
    assert os.stat(replaced / "mine/deep/notes.txt").st_nlink == 1
    assert everything(replaced) == {*NAMES, *foreign, "sub", "mine", "mine/deep", "empty"}
    assert [path.name for path in replaced.parent.iterdir()] == ["out"]


def test_files_of_an_earlier_result_are_removed(replaced: Path) -> None:
    output_folder(replaced, NAMES).replace(contents("new", NAMES[:2]))
    assert words(replaced) == dict.fromkeys(NAMES[:2], "new")
    assert (replaced / "sub" / "other.txt").read_text() == "other"
    (replaced / "sub" / "other.txt").unlink()
    output_folder(replaced, NAMES).replace(contents("newer"))
    output_folder(replaced, NAMES).replace(contents("newest", NAMES[:2]))
    assert not (replaced / "sub").exists()


def test_the_current_directory_of_a_process_is_written_in_place(out: Path) -> None:
    """A shell in the folder still sees its files."""
    before = out.stat().st_ino
    shell = subprocess.Popen(["sleep", "60"], cwd=out)
    try:
        output_folder(out, NAMES).replace(contents("new"))
    finally:
        shell.kill()
        shell.wait()
    assert words(out) == dict.fromkeys(NAMES, "new")
    assert (out.stat().st_ino == before) is Path(f"/proc/{os.getpid()}/cwd").exists()


def test_files_in_a_folder_of_the_user_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("other")
    for word in ("old", "new"):
        written = output_files(tmp_path / "run.csv", ["run.json"]).replace(
            {"run.csv": word, "run.json": word}
        )
    assert written == [tmp_path / "run.csv", tmp_path / "run.json"]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "other.csv": "other",
        "run.csv": "new",
        "run.json": "new",
    }


def test_text_is_written_unchanged(tmp_path: Path) -> None:
    output_files(tmp_path / "a").replace({"a": "\N{GREEK SMALL LETTER TAU}\r\n\udcff"})
    assert (
        tmp_path / "a"
    ).read_bytes() == "\N{GREEK SMALL LETTER TAU}\r\n\N{REPLACEMENT CHARACTER}".encode()


# -- modes and links -------------------------------------------------------------------------------


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_new_files_have_the_mode_of_the_umask(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        output_folder(tmp_path / "out", NAMES).replace(contents("new"))
        output_files(tmp_path / "run.csv").replace({"run.csv": ""})
    finally:
        os.umask(before)
    for path in (tmp_path / "out").rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (0o777 if path.is_dir() else 0o666) & ~mask
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o777 & ~mask
    assert stat.S_IMODE((tmp_path / "run.csv").stat().st_mode) == 0o666 & ~mask


def test_replaced_files_keep_their_modes(replaced: Path) -> None:
    replaced.chmod(0o2750)
    (replaced / "mine").chmod(0o700)
    (replaced / NAMES[0]).chmod(0o600)
    (replaced / NAMES[1]).chmod(0o664)
    output_folder(replaced, NAMES).replace(contents("new"))
    modes = [stat.S_IMODE((replaced / name).stat().st_mode) for name in (".", "mine", *NAMES[:2])]
    assert modes == [0o2750, 0o700, 0o600, 0o664]


def test_links_are_followed(out: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (out / "sub" / "other.txt").unlink()
    for name in ("main.json", "sub"):
        (out / name).rename(tmp_path / "elsewhere" / name)
        (out / name).symlink_to(tmp_path / "elsewhere" / name)
    (out / "page.html").unlink()
    (out / "page.html").symlink_to(tmp_path / "elsewhere" / "page.html")
    (tmp_path / "way").symlink_to(out)
    output_folder(tmp_path / "way", NAMES).replace(contents("new"))
    assert words(out) == dict.fromkeys(NAMES, "new")
    assert (
        all((out / name).is_symlink() for name in ("main.json", "sub", "page.html"))
        and (tmp_path / "way").is_symlink()
    )
    assert everything(tmp_path / "elsewhere") == {"main.json", "sub", "sub/main.json", "page.html"}


def test_a_link_to_an_exchanged_folder_is_followed(out: Path, tmp_path: Path) -> None:
    (tmp_path / "way").symlink_to("out")
    output_folder(tmp_path / "way", NAMES).replace(contents("new"))
    assert words(out) == dict.fromkeys(NAMES, "new") and os.readlink(tmp_path / "way") == "out"


# -- refusals --------------------------------------------------------------------------------------


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _folder(path: Path) -> None:
    path.mkdir()


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as endpoint:
        before = os.getcwd()
        os.chdir(path.parent)  # names of sockets have at most 107 bytes
        try:
            endpoint.bind(path.name)
        finally:
            os.chdir(before)


def _device(path: Path) -> None:
    path.symlink_to("/dev/null")


def _link_to_pipe(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))
    path.symlink_to("pipe")


def _unread_states(folder: Path) -> dict[str, tuple[int, ...]]:
    """Return mode, inode, size and time of change of every entry; reading a link is no change."""
    states = {path.name: os.lstat(path) for path in folder.iterdir()}
    return {k: (s.st_mode, s.st_ino, s.st_size, s.st_mtime_ns) for k, s in states.items()}


@pytest.mark.parametrize("make", [_pipe, _folder, _loop, _socket, _device, _link_to_pipe])
@pytest.mark.parametrize("name", ["run.csv", "run.json"])
def test_special_files_are_refused(tmp_path: Path, name: str, make) -> None:
    make(tmp_path / name)
    before = _unread_states(tmp_path)
    with pytest.raises(
        UnusableInput,
        match=rf"{name}: cannot be written \(is .*\); give the name of a file with -o",
    ):
        output_files(tmp_path / "run.csv", ["run.json"])
    assert _unread_states(tmp_path) == before


def test_special_files_that_appear_after_the_check_are_refused(tmp_path: Path) -> None:
    output = output_folder(tmp_path, NAMES)
    os.mkfifo(tmp_path / NAMES[1])
    with pytest.raises(UnusableInput, match="is a pipe"):
        output.replace(contents("new"))
    assert everything(tmp_path) == {NAMES[1]}


def test_the_null_device_stays_a_device() -> None:
    with pytest.raises(UnusableInput, match="is a character device"):
        output_files(Path(os.devnull))
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "deep"):
        with pytest.raises(UnusableInput, match=r"cannot be written \(.*is not a folder\)"):
            output_folder(folder, NAMES)


def test_a_file_in_the_place_of_a_subfolder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sub").write_text("mine")
    output = OutputFiles(tmp_path, NAMES, owns_folder=True)
    with pytest.raises(UnusableInput, match="sub is not a folder"):
        output.replace(contents("new"))
    assert everything(tmp_path) == {"sub"} and (tmp_path / "sub").read_text() == "mine"


def test_a_long_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match="its name is too long"):
        output_files(tmp_path / ("x" * 300))
    with pytest.raises(UnusableInput, match="its name is too long"):
        output_folder(tmp_path / ("x" * 300), NAMES)
    output_folder(tmp_path / ("x" * 250), NAMES).replace(contents("new"))


def test_two_outputs_with_the_same_target_are_refused(tmp_path: Path) -> None:
    (tmp_path / NAMES[1]).symlink_to(NAMES[0])
    with pytest.raises(UnusableInput, match=r"table\.csv.*the same file as another output"):
        output_folder(tmp_path, NAMES)


def test_an_input_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("input")
    with pytest.raises(UnusableInput, match=r"run\.json.*is an input of this command"):
        output_files(
            tmp_path / "run.csv", ["run.json"], inputs=[tmp_path / "other", tmp_path / "run.json"]
        )


@pytest.mark.parametrize("name", ["", ".", "..", "a/.."])
def test_the_name_of_a_folder_is_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnusableInput, match="is a folder"):
        output_files(Path(name))


def run_limited(script: str, tmp_path: Path, *limits: str) -> subprocess.CompletedProcess[str]:
    imports = "from excite._system.output_files import output_files, output_folder"
    code = f"from pathlib import Path\n{imports}\n{script}"
    shell = "".join(f"ulimit {limit}; " for limit in limits) + 'exec "$0" -c "$1"'
    return subprocess.run(
        ["/bin/sh", "-c", shell, sys.executable, code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )


@pytest.mark.parametrize("exists", [True, False])
def test_a_full_disk_changes_nothing(tmp_path: Path, exists: bool) -> None:
    if exists:
        output_folder(tmp_path / "out", NAMES).replace(contents("old"))
    before = everything(tmp_path)
    script = f"""
big = dict.fromkeys({NAMES!r}, "x") | {{"page.html": "x" * 100_000}}
output_folder(Path("out"), {NAMES!r}).replace(big)
"""
    done = run_limited(script, tmp_path, "-f 20")
    assert "out: cannot be written (File too large); give another -o" in done.stderr
    assert everything(tmp_path) == before
    assert words(tmp_path / "out") == dict.fromkeys(NAMES if exists else (), "old")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere"
)
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(UnusableInput, match="no permission to write"):
            output_folder(tmp_path / "out", NAMES)
    finally:
        tmp_path.chmod(0o700)


# -- killed processes ------------------------------------------------------------------------------

KILLER = """
import json, os, shutil, signal, sys
from pathlib import Path
from excite._system.output_files import OutputFiles

names, folder, kind = json.loads(sys.argv[1]), Path(sys.argv[2]).resolve(), sys.argv[3]
EVENTS = (
    "open", "os.mkdir", "os.rename", "os.link", "os.chmod", "os.remove", "os.rmdir", "os.listdir",
    "os.scandir", "ctypes.dlsym",
)

def replace(at):
    count = 0
    def hook(event, arguments):
        nonlocal count
        count += event in EVENTS
        if count == at and event in EVENTS:
            os.kill(os.getpid(), signal.SIGKILL)
    if kind == "in place":
        os.chdir(folder)
    output = OutputFiles(folder, tuple(names), kind != "siblings")
    sys.addaudithook(hook)
    written = [name for name in names if not (kind == "exchanged" and name == names[2])]
    output.replace({name: f"new {name}" for name in written})

def forked(at):
    if (child := os.fork()) == 0:
        replace(at)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

states, at, code = [], 0, -9
while code == -9:
    at += 1
    shutil.rmtree(folder, ignore_errors=True)
    if kind != "fresh":
        for name in (*names, "sub/mine.txt"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(f"old {name}")
    code = forked(at)
    files = [folder / name for name in names]
    states.append([path.read_text().split()[0] if path.exists() else "" for path in files])
    assert kind == "fresh" or (folder / "sub/mine.txt").read_text() == "old sub/mine.txt"
    assert forked(0) == 0  # the next run removes the staging directories
    remaining = [str(path) for path in folder.parent.rglob("*.partial")]
    assert not remaining, (at, remaining)
assert code == 0
print(json.dumps(states))
"""


def killed(folder: Path, kind: str) -> list[list[str]]:
    """Return the state of each file of the set after a kill at each operation.

    The last state is that of the complete run.
    """
    command = [sys.executable, "-c", KILLER, json.dumps(NAMES), str(folder / "out"), kind]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


@needs_fork
@pytest.mark.skipif(sys.platform != "linux", reason="renameat2 is Linux's")
def test_a_kill_at_any_moment_leaves_the_old_or_the_new_folder(tmp_path: Path) -> None:
    states = killed(tmp_path, "exchanged")
    old, new = ["old"] * 4, ["new", "new", "", "new"]
    first = states.index(new)
    assert states == [old] * first + [new] * (len(states) - first)
    assert 20 < first < len(states) - 3


@needs_fork
def test_a_kill_at_any_moment_leaves_the_complete_new_folder_or_none(tmp_path: Path) -> None:
    states = killed(tmp_path, "fresh")
    assert states[0] == [""] * 4 and states[-1] == ["new"] * 4
    assert all(state in (states[0], states[-1]) for state in states)


@needs_fork
@pytest.mark.parametrize("kind", ["in place", "siblings"])
def test_a_kill_in_place_never_mixes_old_and_new_files(tmp_path: Path, kind: str) -> None:
    states = killed(tmp_path, kind)
    assert states[0] == ["old"] * 4 and states[-1] == ["new"] * 4
    for state in states:
        assert len(set(state) - {""}) <= 1
        assert "" not in state or state[0] == ""
    assert ["", "", "", ""] in states


def test_staging_directories_of_running_processes_are_kept(out: Path) -> None:
    script = (
        "import sys, time\nfrom pathlib import Path\n"
        "from excite._system.staging import StagingDirectory\n"
        "with StagingDirectory(Path(sys.argv[1]), 'out'):\n"
        " print('ready', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(out.parent)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        output_folder(out, NAMES).replace(contents("new"))
        assert [path.suffix for path in out.parent.iterdir() if path.is_dir() and path != out] == [
            ".partial"
        ]
    finally:
        process.kill()
        process.communicate()
    output_folder(out, NAMES).replace(contents("newer"))
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_concurrent_processes_leave_a_complete_set(tmp_path: Path) -> None:
    """Some processes exchange the folder, some write in place."""
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from excite._system.output_files import output_folder\n"
        f"names = {NAMES!r}\n"
        "for _ in range(30):\n"
        " output_folder(Path(sys.argv[1]), names).replace({name: sys.argv[2] for name in names})"
    )
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    command = [sys.executable, "-c", script, str(tmp_path / "out")]
    processes = [
        subprocess.Popen([*command, word], stderr=subprocess.PIPE, text=True)
        for word in ("one", "two", "three")
    ]
    errors = [process.communicate()[1] for process in processes]
    assert errors == [""] * 3
    assert len(set(words(tmp_path / "out").values())) == 1 and len(words(tmp_path / "out")) == 4
    assert everything(tmp_path) == {
        "out",
        "out/mine",
        "out/sub",
        *(f"out/{name}" for name in NAMES),
    }


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="renameat2 is Linux's")
def test_a_killed_command_leaves_the_old_or_the_new_files() -> None:
    command = [
        sys.executable,
        str(SCRIPTS / "kill_test.py"),
        "--random",
        "0",
        "--between",
        "1",
        "--only",
        "exchanged",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


# -- commands --------------------------------------------------------------------------------------

QUICK = ["--starts", "1", "--iterations", "15", "--harmonics", "3", "--samples", "60"]
TRAJECTORY = Path(excite.__file__).parent.parent / "trajectories" / "two_link.json"


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert code == 2 and out == ""
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("excite: "), err
    return lines[0]


@pytest.mark.parametrize(
    "command",
    [
        ["design", "two_link", "-o", "out"],
        ["identifiability", "two_link", TRAJECTORY, "-o", "out"],
        ["identify", "two_link", "no.csv", "-o", "out"],
        ["diagnose", "two_link", "no.csv", "--validate", "no.csv", "-o", "out"],
    ],
    ids=lambda command: command[0],
)
def test_commands_check_their_folder_first(capsys, tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / "report.html")
    line = refused(capsys, *command)  # without progress messages
    assert "out/report.html: cannot be written (is a pipe, not a regular file)" in line


@pytest.mark.parametrize(
    "command",
    [
        ["export", TRAJECTORY, "--format", "csv", "-o", "x.csv"],
        ["simulate", "two_link", TRAJECTORY, "-o", "x.csv"],
        ["predict", "no.json", "no.csv", "-o", "x.csv"],
    ],
    ids=lambda command: command[0],
)
def test_commands_check_their_file_first(capsys, tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo(tmp_path / "x.csv")
    assert "x.csv: cannot be written (is a pipe, not a regular file)" in refused(capsys, *command)
    (tmp_path / "x.csv").unlink()
    (tmp_path / "x.csv").symlink_to("/dev/full")
    assert "x.csv: cannot be written (is a character device, not a regular file)" in refused(
        capsys, *command
    )
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


@pytest.mark.parametrize("redirection", ["| cat", "> file", ">> file"])
def test_export_to_standard_output_is_refused(tmp_path: Path, redirection: str) -> None:
    export = '"$0" -m excite export "$1" --format csv -o /dev/stdout'
    script = f"{export} {redirection}; cat file 2> /dev/null"
    done = subprocess.run(
        ["/bin/sh", "-c", script, sys.executable, str(TRAJECTORY)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.stdout == "" and done.stderr.startswith(
        "excite: /dev/stdout: cannot be written (is "
    )


def test_simulate_does_not_replace_its_trajectory(capsys, tmp_path) -> None:
    (tmp_path / "trajectory.json").write_bytes(TRAJECTORY.read_bytes())
    line = refused(
        capsys,
        "simulate",
        "two_link",
        tmp_path / "trajectory.json",
        "-o",
        tmp_path / "trajectory.csv",
    )
    assert "is an input of this command" in line
    assert (tmp_path / "trajectory.json").read_bytes() == TRAJECTORY.read_bytes()


INPUTS_AS_OUTPUTS = [
    "check robot.urdf --limits-template robot.urdf",
    "check robot.urdf --limits limits.toml --limits-template limits.toml",
    "identify out/identified.urdf run.csv -o out",
    "identify robot.urdf run.csv --prior out/model.json -o out",
    "identify robot.urdf run.csv --bounds out/report.html -o out",
    "identify robot.urdf run.csv --validate link.csv -o out",
    "identify --floating robot.urdf run.csv --limits out/model.json -o out",
    "diagnose robot.urdf run.csv --validate run.csv --before out/diagnosis.json -o out",
    "diagnose robot.urdf run.csv --validate run.csv --prior out/model.json -o out",
    "design robot.urdf --given out/trajectory.csv -o out",
    "design robot.urdf --discriminate out/validation/trajectory.json --validation -o out",
    "identifiability robot.urdf run.csv --limits out/identifiability.json -o out",
    "payload robot.urdf --with run.csv --model out/payload.json -o out",
    "payload robot.urdf --with run.csv --without run.csv --shape mesh:out/report.html@0,0,1 -o out",
    "check robot.urdf.xacro --limits-template parts/arm.xacro",
    "identify robot.urdf.xacro run.csv -o out",
    "check scene.xml --limits-template parts/arm.xml",
    "replay out/replay.json run.csv -o out",
    "predict out/model.json run.csv -o out/model.json",
    "predict out/model.json run.csv -o run.json",
    "simulate robot.urdf two_link.json -o two_link.csv",
    "export two_link.json --robot robot.urdf --format csv -o robot.urdf",
    "export two_link.json --robot robot.urdf --format urscript -o two_link.json",
    "export out/model.json --recording run.csv --format mjcf -o run.json",
]
"""Commands that would replace one of their inputs or the sidecar of a recording."""


@pytest.mark.parametrize("command", INPUTS_AS_OUTPUTS)
def test_commands_do_not_replace_their_inputs(capsys, tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (
        *("limits.toml", "run.csv", "run.json"),
        *(f"out/{name}" for name in ("trajectory.csv", "validation/trajectory.json")),
        *(f"out/{name}.json" for name in ("model", "diagnosis", "identifiability", "payload")),
        *("out/identified.urdf", "out/report.html", "out/replay.json"),
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('{"schema": "excite.model/1"}')
    robot = text_of("two_link")
    (tmp_path / "robot.urdf").write_text(robot)
    (tmp_path / "two_link.json").write_bytes(TRAJECTORY.read_bytes())
    macros = (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="{}"/></robot>'
    )
    (tmp_path / "parts").mkdir()
    for name, text in {
        "robot.urdf.xacro": macros.format("parts/arm.xacro"),
        "parts/arm.xacro": macros.format("$(dirname)/../out/identified.urdf"),
        "scene.xml": '<mujoco><include file="parts/arm.xml"/></mujoco>',
        "parts/arm.xml": '<mujocoinclude><include file="../parts/arm.xml"/></mujocoinclude>',
    }.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "link.csv").symlink_to(tmp_path / "out" / "report.html")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    line = refused(capsys, *command.split())
    assert "cannot be written (is an input of this command); give another -" in line
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before


@pytest.mark.parametrize("name", ["robot.urdf", "two_link.toml", "cell.toml", "arm.srdf"])
def test_export_does_not_replace_files_of_its_trajectory(capsys, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    table = locate("two_link").with_suffix(".toml").read_text(encoding="utf-8")
    for file, text in (
        ("robot.urdf", text_of("two_link")),
        ("two_link.toml", table),
        ("cell.toml", ""),
        ("arm.srdf", '<robot name="two_link"/>'),
    ):
        (tmp_path / file).write_text(text, encoding="utf-8")
    document = json.loads(TRAJECTORY.read_text(encoding="utf-8"))
    document["robot"]["source"] = str(tmp_path / "robot.urdf")
    files = {"scene": str(tmp_path / "cell.toml"), "srdf": str(tmp_path / "arm.srdf")}
    document["design"]["cell"]["recipe"] = {"packages": [], **files}
    (tmp_path / "trajectory.json").write_text(json.dumps(document), encoding="utf-8")
    before = (tmp_path / name).read_bytes()
    line = refused(
        capsys, "export", "trajectory.json", "--force", "--format", "csv", "-o", f"./{name}"
    )
    assert f"{name}: cannot be written (is an input of this command)" in line
    assert (tmp_path / name).read_bytes() == before


@pytest.mark.filterwarnings("ignore:.*begins or ends in motion:excite.errors.ExciteWarning")
def test_results_in_python_do_not_replace_what_they_were_computed_from(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = write_recording(recording_of(None, 2), Path("run.csv"))
    excite.identify("two_link", [run]).save("model")
    prior = {"schema": "excite.prior/1", "trust_prior": True, "joints": {}}
    (tmp_path / "model" / "model.json").write_text(json.dumps(prior))
    again = excite.identify("two_link", [run], prior="model/model.json")
    again.save("other")
    predicted = excite.predict("other/model.json", run)
    exported = excite.export_model("other/model.json", "urdf", recording=run)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.chdir(tmp_path / "other")  # the paths were relative to the other folder
    for write in (
        lambda: again.save("../model"),
        lambda: again.report("../run.csv"),
        lambda: predicted.save("../run.csv"),
        lambda: predicted.save("model.json"),
        lambda: exported.save("../run.json"),
        lambda: exported.report("model.json"),
    ):
        with pytest.raises(UnusableInput, match="is an input of this command"):
            write()
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before


def test_a_design_without_validation_removes_an_earlier_validation(
    tmp_path: Path,
) -> None:
    for options in (["--validation"], []):
        assert main(["design", "two_link", "-o", str(tmp_path / "out"), *QUICK, *options]) == 0
    assert everything(tmp_path / "out") == {
        "trajectory.json",
        "trajectory.csv",
        "identifiability.json",
        "report.html",
    }


def test_the_note_of_an_exported_file_is_removed_with_it(tmp_path: Path) -> None:
    command = [
        "export",
        str(TRAJECTORY.with_name("panda.json")),
        "-o",
        str(tmp_path / "x"),
        "--format",
    ]
    assert main([*command, "franka-csv"]) == 0 and everything(tmp_path) == {"x", "x.txt"}
    assert main([*command, "csv"]) == 0 and everything(tmp_path) == {"x"}
    (tmp_path / "x.txt").write_text("mine")
    assert main([*command, "csv"]) == 0 and (tmp_path / "x.txt").read_text() == "mine"


def test_the_same_command_gives_the_same_files(tmp_path: Path) -> None:
    contents_of_runs = []
    for name in ("a", "b"):
        assert (
            main(["design", "two_link", "-o", str(tmp_path / name), "--time", "12", *QUICK[:4]])
            == 0
        )
        contents_of_runs.append(
            {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        )
    assert contents_of_runs[0] == contents_of_runs[1]

"""The grammar of the command line. It imports nothing heavy: `excite --help` has to be quick."""

from __future__ import annotations

import argparse
import re
import sys
from difflib import get_close_matches
from typing import Any, NoReturn, TypeAlias

from .. import __version__
from .. import physical_ranges as ranges
from .._system.console import emit
from ..errors import UnusableInput
from ..physical_ranges import Range
from .option_types import ColumnNames, NamedNumbers, Number, Numbers, WordOrNumbers

SECONDS, HERTZ = ranges.PERIOD, ranges.RATE
SLOWDOWN = Range(1e-3, 1.0, "1")
SEED = Number(ranges.SEED, whole=True)
"""Seeds are stated in JSON files, of which many readers take integers up to 2⁵³ exactly."""
VARIANCE = Range(1e-12, 1e12, "1")
SHARE = Range(0.0, 10.0, "1", smallest=1e-12)

EXAMPLES = """examples:
  excite design ur10e -o out/ur10e
  excite verify out/ur10e/trajectory.json
  excite export out/ur10e/trajectory.json --format urscript -o ur10e.script
  excite identify ur10e monday.csv --validate tuesday.csv -o out/model
  excite predict out/model/model.json wednesday.csv -o torque.csv
  excite design ur10e --given monday.csv --validation -o out/next
"""


RECORDINGS = """recordings:
  A CSV has columns t, q.<joint> and tau.<joint> [s, rad or m, N m or N], or i.<joint> [A] with a drive_gain per joint; dq, qref,
  qlink and temp are read too. CSV of PlotJuggler, 'ros2 topic echo --csv' and ur_rtde is known; --columns names others. run.json beside run.csv says what columns cannot: {"schema": "excite.recording/1", "period": 6.2,
  "periodic": [0.8, 25.6], "drive_gain": {"elbow": 0.11}}. --trajectory takes both from the motion that was executed. A noise floor
  takes two whole periods within that window.

examples:
  excite identify ur10e monday.csv --validate tuesday.csv -o out/model
  excite identify arm.urdf a.csv b.csv --validate c.csv --period 8 --bounds masses.toml --check-lmi -o out/model
"""  # noqa: E501


class _Parser(argparse.ArgumentParser):
    """Wrong use is one line, exit code 2."""

    def _print_message(self, message: str, file: object = None) -> None:
        emit(message)  # --help, --version

    def error(self, message: str) -> NoReturn:
        # the name of the program stands before every message
        command = self.prog.removeprefix("excite").strip()
        message += self._suggestion(message)
        raise UnusableInput(
            f"{command + ': ' if command else ''}{message} (see {self.prog} --help)"
        )

    def _suggestion(self, message: str) -> str:
        """Return a known command or option that is spelt nearly like the one that is refused."""
        unknown = re.search(r"invalid choice: '([^']*)'|unrecognized arguments: (\S+)", message)
        if unknown is None:
            return ""
        known = [
            word
            for action in self._actions
            for word in (*action.option_strings, *(action.choices or ()))
        ]
        near = get_close_matches(unknown[1] or unknown[2], map(str, known), 1)
        return f"; did you mean {near[0]}?" if near else ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse a command line; `--option=--`, of which argparse makes an empty list whatever the
        option's type, is refused."""
        words = sys.argv[1:] if args is None else list(args)
        for word in words:
            if word.startswith("-") and word.endswith("=--"):
                self.error(f"argument {word.removesuffix('=--')}: '--' is no value")
        return super().parse_known_args(words, namespace)


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = _Parser(
        prog="excite",
        description="Excitation trajectories for robots, and physically consistent parameters from what was recorded.",  # noqa: E501
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"excite {__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _robots(commands)
    _command(commands, "effects", "list the effects that a diagnosis can report")
    _command(commands, "formats", "list the formats of excite export")
    _design(commands)
    _verify(commands)
    _export(commands)
    _identifiability(commands)
    _identify(commands)
    _predict(commands)
    _diagnose(commands)
    _simulate(commands)
    _view(commands)
    return top


Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"


def _command(commands: Commands, name: str, text: str) -> argparse.ArgumentParser:
    sub: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + "."
    )
    sub.add_argument(
        "--json",
        action="store_true",
        help="print one JSON document on standard output, nothing else there",
    )
    volume = sub.add_mutually_exclusive_group()
    volume.add_argument("-q", "--quiet", action="store_true", help="no progress, no warnings")
    volume.add_argument(
        "-v", "--verbose", action="store_true", help="every step of the progress, with its time"
    )
    return sub


def _robots(commands: Commands) -> None:
    _command(commands, "robots", "list the built-in robots")


def _robot_options(sub: argparse.ArgumentParser) -> None:
    group = sub.add_argument_group("robot")
    group.add_argument(
        "robot", metavar="ROBOT", help="path of a URDF, or a name that 'excite robots' lists"
    )
    group.add_argument(
        "--joints", metavar="A,B,…", help="the joints that move; the others are locked"
    )
    group.add_argument(
        "--lock",
        type=NamedNumbers("NAME=VALUE", "=", Numbers(ranges.POSITION, (1,))),
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="lock a joint at a position [rad or m]",
    )
    group.add_argument(
        "--limits",
        metavar="FILE",
        help="TOML or MoveIt joint_limits.yaml that overrides the URDF's limits",
    )
    body = "LINK:M[,CX,CY,CZ[,IXX,IXY,IYY,IXZ,IYZ,IZZ]]"
    quantities = (ranges.MASS, *[ranges.LENGTH] * 3, *[ranges.INERTIA] * 6)
    group.add_argument(
        "--payload",
        type=NamedNumbers(body, ":", Numbers(quantities, (1, 4, 10))),
        metavar=body,
        help="a body at a link: kg, m, kg m² about its centre",
    )
    group.add_argument(
        "--gravity",
        type=Numbers(ranges.GRAVITY, (3,)),
        metavar="X,Y,Z",
        default="0,0,-9.81",
        help="in the base frame [m/s²] (default %(default)s)",
    )


def _model_options(sub: argparse.ArgumentParser) -> None:
    group = sub.add_argument_group("parameters")
    group.add_argument(
        "--parameters",
        choices=("inertial", "full"),
        default="full",
        help="full: with rotor inertia, friction and offset (default)",
    )
    group.add_argument(
        "--without",
        metavar="A,B,…",
        default="",
        help="joint parameters to leave out: rotor_inertia, viscous, coulomb, offset",
    )
    group.add_argument(
        "--torque-noise",
        type=Numbers(Range(1e-9, 1e9, "N m or N")),
        metavar="SIGMA[,…]",
        help="standard deviation, one or per joint [N m] (default 1 %% of the torque limit)",
    )
    group.add_argument(
        "--threshold",
        type=Number(VARIANCE),
        default=1e-2,
        help="largest scale-free variance that counts as identifiable (default %(default)s)",
    )


def _design(commands: Commands) -> None:
    sub = _command(commands, "design", "design an excitation trajectory")
    sub.add_argument(
        "-o",
        dest="out",
        metavar="DIR",
        required=True,
        help="folder for trajectory.json, trajectory.csv, identifiability.json, report.html",
    )
    _robot_options(sub)
    _model_options(sub)
    group = sub.add_argument_group("criterion")
    group.add_argument(
        "--criterion",
        choices=("a", "d", "e", "cond", "cond_regressor"),
        default="a",
        help="default %(default)s",
    )
    group.add_argument(
        "--plain", action="store_true", help="the Euclidean criterion instead of the geometric one"
    )
    group.add_argument(
        "--given",
        metavar="FILE",
        action="append",
        default=[],
        help="trajectory.json or recording whose information is already there",
    )
    group = sub.add_argument_group("motion")
    group.add_argument(
        "--time",
        type=Number(SECONDS),
        metavar="S",
        help="robot time, ramps included [s]: choose the next four for it unless given",
    )
    group.add_argument(
        "--harmonics",
        type=Number(ranges.HARMONICS, whole=True),
        metavar="K",
        help="default 5, or chosen for --time",
    )
    group.add_argument(
        "--period",
        type=Number(SECONDS),
        metavar="S",
        help="[s] (default: from the limits: a sweep of the ranges at full speed)",
    )
    group.add_argument(
        "--optimise-period",
        type=Numbers(SECONDS, (2,), increasing=True),
        metavar="MIN,MAX",
        help="let the period vary between these [s]",
    )
    group.add_argument(
        "--samples",
        type=Number(Range(3, ranges.SAMPLES.upper, "1"), whole=True),
        metavar="N",
        help="the optimiser's grid over one period (default 20 per harmonic)",
    )
    group.add_argument(
        "--periods",
        type=Number(Range(2, ranges.PERIODS.upper, "1"), whole=True),
        metavar="N",
        help="repeats in the motion (default 2, or what fits --time)",
    )
    group.add_argument(
        "--rate",
        type=Number(HERTZ),
        default=100.0,
        metavar="HZ",
        help="rows a second in trajectory.csv (default %(default)s)",
    )
    group.add_argument(
        "--validation",
        action="store_true",
        help="a second, different motion too, in DIR/validation, to judge the identified model by",
    )
    group.add_argument(
        "--speed",
        type=Number(SLOWDOWN),
        default=1.0,
        metavar="F",
        help="play the motion at F times its speed, for a first careful run",
    )
    group.add_argument(
        "--start",
        type=Numbers(ranges.POSITION),
        metavar="Q1,…,QN",
        help="pose at which the motion starts and ends, at rest (default: nearest the excitation)",
    )
    group.add_argument(
        "--box",
        type=NamedNumbers("FRAME:XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX", ":", Numbers(ranges.LENGTH, (6,))),
        metavar="FRAME:XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX",
        action="append",
        default=[],
        help="keep a frame's origin in a box [m]",
    )
    group.add_argument(
        "--margin",
        type=Number(Range(0.0, 0.99, "1")),
        metavar="F",
        help="share of velocity, acceleration, jerk and torque limits to keep free (default: the limits file's [margin], or 0.02)",  # noqa: E501
    )
    group.add_argument(
        "--uncertainty",
        type=Number(Range(0.0, 100.0, "1")),
        default=0.1,
        metavar="R",
        help="torque limits hold for all robots this near (default %(default)s)",
    )
    _surroundings(sub)
    group = sub.add_argument_group("search")
    group.add_argument(
        "--starts",
        type=Number(Range(1, 1e6, "1"), whole=True),
        default=2,
        metavar="N",
        help="random starts (default %(default)s)",
    )
    group.add_argument("--seed", type=SEED, default=0, metavar="N", help="default %(default)s")
    group.add_argument(
        "--jobs",
        type=Number(Range(-1024, 1024, "1", zero=False), whole=True),
        default=-1,
        metavar="N",
        help="processes (default: one per core)",
    )
    group.add_argument(
        "--backend",
        choices=("multiprocessing", "loky", "dask", "ray"),
        help="where starts run (default: processes here)",
    )
    group.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="of a running Dask scheduler (tcp://host:8786) or Ray head (ray://host:10001)",
    )
    group.add_argument(
        "--iterations",
        type=Number(Range(1, 1e6, "1"), whole=True),
        default=300,
        metavar="N",
        help="per start (default %(default)s)",
    )
    group.add_argument(
        "--force",
        action="store_true",
        help="write the files even when the certificate fails; they say so",
    )


def _surroundings(sub: argparse.ArgumentParser) -> None:
    group = sub.add_argument_group(
        "surroundings",
        "what the robot must not touch, besides itself; shapes are those of the URDF's <collision>",
    )
    group.add_argument(
        "--scene",
        metavar="FILE",
        help="TOML: boxes, spheres, capsules, cylinders and meshes around the robot or on its links",  # noqa: E501
    )
    group.add_argument(
        "--floor",
        type=Number(ranges.LENGTH),
        metavar="Z",
        help="height in the base frame [m] (default: 0, or the lowest point of the links that do not move)",  # noqa: E501
    )
    group.add_argument("--no-floor", action="store_true", help="there is none")
    group.add_argument(
        "--clearance",
        type=Number(Range(0.0, 1e4, "m")),
        metavar="M",
        help="least distance to keep [m] (default: the scene's, or 0.02)",
    )
    group.add_argument(
        "--srdf",
        metavar="FILE",
        help="pairs of links that may touch (default: neighbours, and what always touches)",
    )
    group.add_argument(
        "--packages",
        metavar="DIR",
        action="append",
        default=[],
        help="where package:// meshes are, besides ROS_PACKAGE_PATH and the URDF's folders",
    )
    group.add_argument(
        "--no-collision", action="store_true", help="check no distances; the files say so"
    )


def _verify(commands: Commands) -> None:
    sub = _command(
        commands, "verify", "recompute every limit and the criterion of a trajectory from its file"
    )
    sub.add_argument("trajectory", metavar="TRAJECTORY")
    _sources(sub)


def _sources(sub: argparse.ArgumentParser) -> None:
    """Options of commands that check a trajectory against the files it was designed with."""
    group = sub.add_argument_group(
        "sources", "where the files that the motion was designed with are now, if they have moved"
    )
    group.add_argument("--robot", metavar="URDF", help="the robot's URDF")
    group.add_argument("--limits", metavar="FILE", help="the limits file")
    group.add_argument(
        "--packages",
        metavar="DIR",
        action="append",
        default=[],
        help="a folder of package:// meshes",
    )


def _export(commands: Commands) -> None:
    sub = _command(commands, "export", "write a trajectory for a controller")
    sub.add_argument("trajectory", metavar="TRAJECTORY")
    sub.add_argument(
        "--format",
        required=True,
        metavar="F",
        help="csv, json, ros2-joint-trajectory, ros2-follow-joint-trajectory, ur-csv, …",
    )
    sub.add_argument("-o", dest="out", metavar="FILE", required=True)
    sub.add_argument(
        "--rate",
        type=Number(HERTZ),
        metavar="HZ",
        help="rows or knots a second, where the format leaves it open",
    )
    sub.add_argument(
        "--speed",
        type=Number(SLOWDOWN),
        default=1.0,
        metavar="F",
        help="play at F times its speed, for a first careful run",
    )
    group = sub.add_argument_group("ROS 2")
    group.add_argument(
        "--lead",
        type=Number(Range(0.1, 600.0, "s")),
        default=5.0,
        metavar="S",
        help="time for the way from the present pose to the start pose (default %(default)s)",
    )
    for name, text in (
        ("path", "deviation from the path at which the controller aborts"),
        ("goal", "deviation at the end that is accepted"),
    ):
        group.add_argument(
            f"--{name}-tolerance",
            type=Number(Range(1e-6, 10.0, "rad or m")),
            metavar="RAD",
            help=f"{text}, at every joint (default: the controller's own)",
        )
    _sources(sub)
    sub.add_argument(
        "--force",
        action="store_true",
        help="export a trajectory that fails its certificate; the file says so",
    )


def _identifiability(commands: Commands) -> None:
    sub = _command(commands, "identifiability", "say what a trajectory or a recording reveals")
    sub.add_argument(
        "-o",
        dest="out",
        metavar="DIR",
        required=True,
        help="folder for identifiability.json and report.html",
    )
    _robot_options(sub)
    sub.add_argument("motion", metavar="TRAJECTORY_OR_RECORDING")
    _recording_options(sub)
    _model_options(sub)


def _identify(commands: Commands) -> None:
    sub = _command(
        commands,
        "identify",
        "find physically consistent parameters from recordings, and say how sure they are",
    )
    sub.epilog, sub.formatter_class = RECORDINGS, argparse.RawDescriptionHelpFormatter
    sub.add_argument(
        "-o",
        dest="out",
        metavar="DIR",
        required=True,
        help="folder for model.json, identified.urdf, report.html",
    )
    _robot_options(sub)
    sub.add_argument(
        "recordings",
        metavar="RECORDING",
        nargs="+",
        help="CSV, .npz, rosbag2 folder, .mcap or ur_rtde CSV",
    )
    sub.add_argument(
        "--validate",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="recordings to judge the model by, not used to fit it",
    )
    group = sub.add_argument_group("parameters")
    group.add_argument(
        "--without",
        metavar="A,B,…",
        default="",
        help="leave out of: rotor_inertia, viscous, coulomb, offset",
    )
    group.add_argument(
        "--parameters",
        choices=("inertial", "full"),
        default="full",
        help="full: with all these (default)",
    )
    group.add_argument(
        "--threshold",
        type=Number(VARIANCE),
        default=1e-2,
        help="largest scale-free variance of what counts as identified (default %(default)s)",
    )
    group = sub.add_argument_group("signals")
    group.add_argument(
        "--band",
        type=Number(HERTZ),
        metavar="HZ",
        help="torque below this frequency is fitted (default: from the data)",
    )
    group.add_argument(
        "--period",
        type=Number(SECONDS),
        metavar="S",
        help="of the excitation, where the recording's .json does not say it",
    )
    group.add_argument(
        "--window",
        type=Numbers(Range(-1e12, 1e12, "s"), (2,), increasing=True),
        metavar="T0,T1",
        help="where it repeats, with --period (default: found in the recording) [s]",
    )
    _recording_options(group)
    group.add_argument(
        "--align", action="store_true", help="move each joint's torque by the delay that is found"
    )
    group = sub.add_argument_group("estimation")
    group.add_argument(
        "--estimator",
        choices=("ols", "wls", "full", "huber", "iv"),
        default="wls",
        help="all rows alike; weighted by each joint's noise; by its covariance; robust to outliers; instruments (default %(default)s)",  # noqa: E501
    )
    group.add_argument(
        "--distance",
        choices=("riemannian", "bregman", "pullback", "euclidean"),
        default="bregman",
        help="how far a body is from the nominal one (default %(default)s)",
    )
    group.add_argument(
        "--gamma",
        type=WordOrNumbers(("evidence", "heldout"), Numbers(VARIANCE, (1, 2))),
        default="evidence",
        metavar="G",
        help="weight of the nominal robot: evidence, heldout (blocks left out), a number, or two for bodies,drives (default %(default)s)",  # noqa: E501
    )
    group.add_argument(
        "--hausman",
        action="store_true",
        help="test whether instruments are needed; takes the commanded motion, qref.<joint>",
    )
    group.add_argument(
        "--simulate", action="store_true", help="also judge the model by positions simulated ahead"
    )
    group.add_argument(
        "--refine",
        action="store_true",
        help="refine the parameters against positions simulated ahead",
    )
    group.add_argument(
        "--check-lmi",
        action="store_true",
        help="solve for consistent parameters by a conic solver too, and compare",
    )
    group.add_argument(
        "--prior", metavar="FILE", help="what is right as it stands: excite.prior/1 or a model.json"
    )
    group.add_argument(
        "--bounds",
        metavar="FILE",
        help="TOML: [links.NAME] mass = [least, most], centre = [[x, y, z], [x, y, z]]",
    )


def _columns_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--columns",
        type=ColumnNames(("q", "dq", "tau", "i", "qref", "qlink", "temp")),
        metavar="NAME=COLUMN,…",
        action="append",
        default=[],
        help="names of a CSV file's columns where they are none of the known ones, as "
        "t=Time,q.elbow=pos_3,tau.elbow=eff_3",
    )


def _recording_options(group: argparse._ActionsContainer) -> None:
    _columns_option(group)
    group.add_argument(
        "--trajectory",
        metavar="FILE",
        action="append",
        default=[],
        help="trajectory.json that was executed: period, window and commanded motion come from it, "
        "aligned in time; may be repeated",
    )


def _predict(commands: Commands) -> None:
    sub = _command(commands, "predict", "predict torque along a recording by an identified model")
    sub.add_argument("model", metavar="MODEL", help="the model.json of 'excite identify'")
    sub.add_argument(
        "recording", metavar="RECORDING", help="the motion; a designed trajectory.csv will do too"
    )
    sub.add_argument(
        "-o",
        dest="out",
        metavar="FILE.csv",
        required=True,
        help="t,tau.<joint>… at the recording's own times",
    )
    _columns_option(sub)


def _diagnose(commands: Commands) -> None:
    sub = _command(
        commands, "diagnose", "say what the model leaves out, where, how much, and how sure that is"
    )
    sub.add_argument(
        "-o",
        dest="out",
        metavar="DIR",
        required=True,
        help="folder for diagnosis.json, model.json, report.html",
    )
    _robot_options(sub)
    sub.add_argument(
        "recordings", metavar="RECORDING", nargs="+", help="recordings that the model is fitted to"
    )
    sub.add_argument(
        "--validate",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="recordings to judge by (needed)",
    )
    sub.add_argument(
        "--prior", metavar="FILE", help="what is right as it stands: excite.prior/1 or a model.json"
    )
    sub.add_argument(
        "--band",
        type=Number(HERTZ),
        metavar="HZ",
        help="torque below this is looked at (default: 20, more where the data asks for it)",
    )
    _recording_options(sub)
    sub.add_argument(
        "--no-report",
        action="store_true",
        help="leave report.html out, which takes a third of the time",
    )


def _simulate(commands: Commands) -> None:
    sub = _command(
        commands,
        "simulate",
        "record a simulated robot that follows a trajectory, with physics that its model does not "
        "have",
    )
    sub.add_argument(
        "robot", metavar="ROBOT", help="path of a URDF, or a name that 'excite robots' lists"
    )
    sub.add_argument(
        "trajectory", metavar="TRAJECTORY", help="the trajectory.json of 'excite design'"
    )
    sub.add_argument(
        "-o",
        dest="out",
        metavar="FILE",
        required=True,
        help="the recording; beside it .json, .truth.json and .svg",
    )
    sub.add_argument(
        "--effect",
        metavar="NAME:JOINT[:k=v,…]",
        action="append",
        default=[],
        help="hide this; 'list' tells what there is",
    )
    sub.add_argument(
        "--severity",
        type=Number(Range(1e-3, 1e6, "1")),
        metavar="S",
        help="scale each effect until a refit of the base model leaves S times the noise of it",
    )
    sub.add_argument(
        "--trusted",
        action="store_true",
        help="with --severity: nothing is refit, as with a trusted prior",
    )
    sub.add_argument(
        "--like",
        metavar="FILE",
        help="the .truth.json of another recording: the same robot, and effects of the same size",
    )
    sub.add_argument(
        "--seed",
        type=SEED,
        metavar="N",
        help="of the true bodies, the drives and the noise (default 0)",
    )
    sub.add_argument(
        "--model-error",
        type=Number(SHARE),
        metavar="F",
        help="how far the true bodies are from the URDF's (default 0.05)",
    )
    sub.add_argument(
        "--periods",
        type=Number(ranges.PERIODS, whole=True),
        metavar="N",
        help="repeats of the excitation (default: as the trajectory says)",
    )
    group = sub.add_argument_group("measurement")
    group.add_argument(
        "--rate",
        type=Number(Range(125.0, 1000.0, "Hz")),
        metavar="HZ",
        help="125 to 1000 (default 500)",
    )
    group.add_argument(
        "--noise",
        type=Number(SHARE),
        metavar="F",
        help="of torque, over the torque limit (default 0.005)",
    )
    group.add_argument(
        "--colour",
        type=Number(HERTZ),
        metavar="HZ",
        help="corner of the noise's spectrum (default: white)",
    )
    group.add_argument(
        "--jitter",
        type=Number(Range(0.0, 1.0, "s")),
        metavar="S",
        help="of the times of sampling, unseen by the clock [s]",
    )
    group.add_argument(
        "--encoder",
        type=Number(Range(0.0, 1.0, "rad or m")),
        metavar="RAD",
        help="resolution of position (default 2e-6)",
    )


def _view(commands: Commands) -> None:
    sub = _command(
        commands, "view", "play a trajectory in a browser, among its surroundings (extra [view])"
    )
    sub.add_argument("trajectory", metavar="TRAJECTORY")
    sub.add_argument("--robot", metavar="URDF", help="where the robot's URDF is now")
    sub.add_argument(
        "--speed",
        type=Number(Range(1e-3, 4.0, "1")),
        default=1.0,
        metavar="F",
        help="play at F times its speed",
    )
    sub.add_argument("--once", action="store_true", help="end after one play")
    sub.add_argument("--host", default="localhost", help="default %(default)s")
    sub.add_argument(
        "--port",
        type=Number(Range(1, 65535, "1"), whole=True),
        default=8080,
        help="default %(default)s, or the next free one",
    )

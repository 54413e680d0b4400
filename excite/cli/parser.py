"""Grammar of the command line.

It imports nothing large, so that `excite --help` is quick.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NoReturn, TypeAlias

from .. import __version__
from .. import physical_ranges as ranges
from .._system.console import emit
from ..designer.identifiability_threshold import IDENTIFIABLE_VARIANCE
from ..errors import UnusableInput
from ..physical_ranges import Range
from .completion import SHELLS, PrintCompletion
from .option_types import ColumnNames, NamedNumbers, Number, Numbers, WordOrNumbers

SECONDS = ranges.PERIOD
"""Range of options in seconds."""
HERTZ = ranges.RATE
"""Range of options in hertz."""
SLOWDOWN = Range(1e-3, 1.0, "1")
"""Range of shares of the designed speed."""
SEED = Number(ranges.SEED, whole=True)
"""Seeds are stated in JSON files; many readers represent integers exactly only up to 2⁵³."""
VARIANCE = Range(1e-12, 1e12, "1")
"""Range of scale-free variances and weights."""
SHARE = Range(0.0, 10.0, "1", smallest=1e-12)
"""Range of relative sizes."""

EXAMPLES = """examples:
  excite design ur10e -o out/ur10e
  excite verify out/ur10e/trajectory.json
  excite export out/ur10e/trajectory.json --format urscript -o ur10e.script
  excite identify ur10e monday.csv --validate tuesday.csv -o out/model
  excite predict out/model/model.json wednesday.csv -o torque.csv
  excite design ur10e --given monday.csv --validation -o out/next
"""


RECORDINGS = """recordings:
  A CSV has the columns t [s], q.<joint> [rad or m] and tau.<joint> [N m or N], or i.<joint> [A]
  and a drive_gain per joint; dq, qref, qlink and temp are read too. CSV files of PlotJuggler, of
  'ros2 topic echo --csv' and of ur_rtde are read as they are, and names such as time, q_<joint>,
  <joint>_pos, /joint_states/<joint>/position, or q1, tau1, … in the order of the robot; --columns
  names other columns. Long tables have a row per joint and time: time, joint, position, torque.
  Times may be dates such as 2025-03-30T01:59:55.008+02:00. The text that 'ros2 topic echo
  /joint_states' prints is read, too, and text may be compressed (run.csv.gz). A file run.json next
  to run.csv holds the metadata: {"schema": "excite.recording/1", "period": 6.2, "periodic": [0.8,
  25.6], "drive_gain": {"elbow": 0.11}}. --trajectory takes period and window from the motion that
  was executed. The noise floor is estimated from two or more whole periods in that window.

examples:
  excite identify ur10e monday.csv --validate tuesday.csv -o out/model
  excite identify arm.urdf a.csv b.csv --validate c.csv --bounds masses.toml -o out/model
"""


class _Parser(argparse.ArgumentParser):
    """Parser that reports wrong use in one line, with exit code 2."""

    def _print_message(self, message: str, file: object = None) -> None:
        emit(message)  # --help, --version

    def error(self, message: str) -> NoReturn:
        command = self.prog.removeprefix("excite").strip()
        message += self._suggestion(message)
        raise UnusableInput(
            f"{command + ': ' if command else ''}{message} (see {self.prog} --help)"
        )

    def _suggestion(self, message: str) -> str:
        """Return the known command, option or value that is most similar to an unknown one."""
        unknown = re.search(r"invalid choice: '([^']*)'|unrecognized arguments: (\S+)", message)
        if unknown is None:
            return ""
        if unknown[2]:
            option = unknown[2].partition("=")[0]
            commands = [
                sub
                for action in self._actions
                if isinstance(action.choices, dict)
                for sub in action.choices.values()
            ]
            if any(option in sub.options() for sub in commands):
                return "; options stand behind the command"
            return _similar(option, self.options())
        place = re.match(r"argument ([^:]+): invalid choice", message)
        known = [
            str(choice)
            for action in self._actions
            if place is None or place[1] in (action.metavar, "/".join(action.option_strings))
            for choice in action.choices or ()
        ]
        return _similar(unknown[1], known)

    def options(self) -> list[str]:
        """Return the names of all options."""
        return [option for action in self._actions for option in action.option_strings]

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse a command line.

        `--option=--` is refused: argparse turns it into an empty list, whatever the option's type.
        So are empty words: an empty path is the current folder. Unknown options are reported before
        missing arguments, which they may have been meant to be, and by the parser of the command:
        argparse reports them by that of the program. A list that begins with a negative number is
        the value of the option in front of it.
        """
        words = sys.argv[1:] if args is None else list(args)
        for before, word in zip(["", *words], words, strict=False):
            option, _, value = word.partition("=")
            if word.startswith("-") and word.endswith(("=", "=--")):
                self.error(f"argument {option}: '{value}' is no value; state one or leave it out")
            if not word:
                place = f"argument {before}: " if before.startswith("-") else ""
                self.error(f"{place}'' is no value; state one or leave it out")
        for k in reversed(range(1, len(words))):
            if re.match(r"-[\d.]+(e[+-]?\d+)?,", words[k], re.I) and words[k - 1] in self.options():
                words[k - 1 : k + 1] = [f"{words[k - 1]}={words[k]}"]
        options = words[: words.index("--")] if "--" in words else words
        if self._subparsers is not None:  # the command is the first word that is no option
            options = options[:1]
        unknown = [word for word in options if self._is_unknown(word)]
        if unknown and not {"-h", "--help"} & set(options):
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        parsed, unknown = super().parse_known_args(words, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return parsed, unknown

    def _is_unknown(self, word: str) -> bool:
        """Return True for an option that abbreviates no known one: `--option`, `-o`.

        Words with blanks are values, as argparse has it, and negative numbers may be some.
        """
        option = word.partition("=")[0]
        if not re.match(r"--\w|-[a-zA-Z]$", option) or " " in word:
            return False
        return not any(known.startswith(option) for known in self.options())


def _similar(word: str, known: Sequence[str]) -> str:
    """Return a question for the known word that is most similar to a word, if there is any."""
    names = {name.lstrip("-"): name for name in known}
    near = get_close_matches(word.lstrip("-"), names, 1)
    return f"; did you mean {names[near[0]]}?" if near else ""


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = _Parser(
        prog="excite",
        description=(
            "Excitation trajectories for robots, and physically consistent parameters from "
            "recordings."
        ),
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"excite {__version__}")
    top.add_argument(
        "--print-completion",
        action=PrintCompletion,
        choices=SHELLS,
        help="print the completion script of a shell (extra [completion])",
    )
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _robots(commands)
    _check(commands)
    _command(commands, "effects", "list the effects that a diagnosis can report")
    _command(commands, "formats", "list the formats of excite export")
    _design(commands)
    _verify(commands)
    _export(commands)
    _identifiability(commands)
    _identify(commands)
    _predict(commands)
    _diagnose(commands)
    _replay(commands)
    _payload(commands)
    _simulate(commands)
    _view(commands)
    return top


Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"


def _command(commands: Commands, name: str, text: str) -> argparse.ArgumentParser:
    sub: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + "."
    )
    sub.set_defaults(default_of=sub.get_default)  # tells stated options from others
    sub.add_argument(
        "--json",
        action="store_true",
        help="print one JSON document, and nothing else, on standard output",
    )
    volume = sub.add_mutually_exclusive_group()
    volume.add_argument(
        "-q", "--quiet", action="store_true", help="print neither progress nor warnings"
    )
    volume.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="print every step of the progress with its time",
    )
    return sub


def _folder_option(sub: argparse.ArgumentParser, text: str) -> None:
    sub.add_argument("-o", dest="out", metavar="DIR", required=True, help=text)


def _band_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--band",
        type=Number(HERTZ),
        metavar="HZ",
        help="cutoff of the low-pass filter of the torque (default: chosen from the data)",
    )


def _robots(commands: Commands) -> None:
    _command(commands, "robots", "list the built-in robots")


def _check(commands: Commands) -> None:
    sub = _command(commands, "check", "say what is missing or implausible in a robot, all at once")
    sub.epilog = (
        "Exit code 0: usable; 1: something has to be corrected before a design; 2: the file cannot "
        "be used."
    )
    _robot_options(sub)
    sub.add_argument(
        "--limits-template",
        metavar="FILE",
        help="write a limits file with what is known and blanks for the rest",
    )
    _packages_option(sub)


def _packages_option(group: argparse._ActionsContainer, others: str = "") -> None:
    group.add_argument(
        "--packages",
        metavar="DIR",
        action="append",
        default=[],
        help=f"folder of package:// meshes{others}",
    )


def _robot_argument(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "robot",
        metavar="ROBOT",
        help="path of a URDF or an MJCF file, or a name that 'excite robots' lists",
    )


def _robot_options(sub: argparse.ArgumentParser, *, payload: bool = True) -> None:
    """Add the options that describe the robot.

    Args:
        sub: Parser of the command.
        payload: Whether a payload and the robot's mass may be stated.
    """
    group = sub.add_argument_group("robot")
    _robot_argument(group)
    group.add_argument(
        "--joints", metavar="A,B,…", help="joints that move; the others are locked (default: all)"
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
    if payload:
        _payload_options(group)
    group.add_argument(
        "--gravity",
        type=Numbers(ranges.GRAVITY, (3,)),
        metavar="X,Y,Z",
        default="0,0,-9.81",
        help="gravity in the base frame [m/s²] (default %(default)s)",
    )


def _payload_options(group: argparse._ActionsContainer) -> None:
    """Add the options that state masses of the robot and of a payload."""
    body = "LINK:M[,CX,CY,CZ[,IXX,IXY,IYY,IXZ,IYZ,IZZ]]"
    quantities = (ranges.MASS, *[ranges.LENGTH] * 3, *[ranges.INERTIA] * 6)
    group.add_argument(
        "--payload",
        type=NamedNumbers(body, ":", Numbers(quantities, (1, 4, 10))),
        metavar=body,
        action="append",
        default=[],
        help="body attached to a link: mass [kg], centre of mass [m], inertia about it [kg m²]",
    )
    group.add_argument(
        "--mass",
        type=Numbers(ranges.MASS, (1,)),
        metavar="KG",
        help="mass of the complete robot: links without <inertial> get uniform bodies in their "
        "collision shapes",
    )


def _model_options(sub: argparse.ArgumentParser) -> argparse._ActionsContainer:
    group = sub.add_argument_group("parameters")
    group.add_argument(
        "--parameters",
        choices=("inertial", "full"),
        default="full",
        help=(
            "inertial: link inertial parameters only; full: also rotor inertia, friction and "
            "offset (default)"
        ),
    )
    group.add_argument(
        "--without",
        metavar="A,B,…",
        default="",
        help="joint parameters to leave out: rotor_inertia, viscous, coulomb, offset",
    )
    group.add_argument(
        "--threshold",
        type=Number(VARIANCE),
        default=IDENTIFIABLE_VARIANCE,
        help="largest scale-free variance of an identifiable direction (default %(default)s)",
    )
    return group


def _torque_noise_option(group: argparse._ActionsContainer, default: str) -> None:
    group.add_argument(
        "--torque-noise",
        type=Numbers(Range(1e-9, 1e9, "N m or N")),
        metavar="SIGMA[,…]",
        help=(
            "standard deviation of the torque noise, one value or one per joint [N m] (default: "
            f"{default})"
        ),
    )


def _support_options(sub: argparse.ArgumentParser) -> None:
    """Add the options of a robot that stands on its feet."""
    group = sub.add_argument_group("single or double support")
    group.add_argument(
        "--floating",
        action="store_true",
        help="the base moves freely and the feet of --support stand on the ground",
    )
    group.add_argument(
        "--support",
        metavar="FRAME[,FRAME]",
        help="frames of the soles that stand on the ground, z axis up, each at the end of a leg of "
        "six joints",
    )
    group.add_argument(
        "--sole",
        type=Numbers(ranges.LENGTH, (2, 4, 5)),
        metavar="LENGTH,WIDTH[,X,Y[,Z]]",
        help="size of a sole along x and y of its frame, and its centre [m] (default: the lowest "
        "points of the foot's shapes)",
    )
    group.add_argument(
        "--cop-margin",
        type=Number(ranges.LENGTH),
        metavar="M",
        help="distance of the centre of pressure from the edges of each sole [m] (default 0.02)",
    )
    group.add_argument(
        "--friction",
        type=Number(Range(1e-3, 10.0, "1")),
        metavar="MU",
        help="coefficient of friction of the soles (default 0.6)",
    )
    group.add_argument(
        "--duration",
        type=Number(Range(0.2, 1e3, "s")),
        metavar="S",
        help="duration of each motion [s] (default 3)",
    )
    group.add_argument(
        "--motions",
        type=Number(Range(1, 1000, "1"), whole=True),
        metavar="N",
        help="number of motions, each from the standing pose and back (default 1)",
    )
    _wrench_noise_option(group)


def _design(commands: Commands) -> None:
    sub = _command(commands, "design", "design an excitation trajectory")
    _folder_option(
        sub, "folder for trajectory.json, trajectory.csv, identifiability.json, report.html"
    )
    _robot_options(sub)
    _torque_noise_option(_model_options(sub), "1 %% of the torque limit")
    _support_options(sub)
    group = sub.add_argument_group("criterion")
    group.add_argument(
        "--criterion",
        choices=("a", "d", "e", "cond", "cond_regressor"),
        default="a",
        help="optimality criterion (default %(default)s)",
    )
    group.add_argument(
        "--plain",
        action="store_true",
        help="use the Euclidean criterion instead of the geometric one",
    )
    group.add_argument(
        "--given",
        metavar="FILE",
        action="append",
        default=[],
        help="trajectory.json or recording whose information is already available; may be repeated",
    )
    _recording_options(group)
    group.add_argument(
        "--for",
        dest="for_task",
        metavar="TASK",
        help=(
            "recording (CSV with q, …) or trajectory.json of a task: design for the least "
            "predicted torque variance along it"
        ),
    )
    group.add_argument(
        "--discriminate",
        metavar="DIAGNOSIS",
        help=(
            "diagnosis.json: design for the largest separation of its competing explanations, and "
            "compare other experiments"
        ),
    )
    group.add_argument(
        "--for-payload",
        metavar="LINK",
        help="show a payload on this link of a robot that is known, friction eliminated (15 s "
        "unless --time or --period is given)",
    )
    group.add_argument(
        "--static",
        action="store_true",
        help="with --for-payload: a few D-optimal poses at rest instead of a motion, which show "
        "mass and centre of mass, not the inertia",
    )
    group.add_argument(
        "--poses",
        type=Number(Range(4, 100, "1"), whole=True),
        metavar="N",
        help="number of static poses (default 6)",
    )
    group = sub.add_argument_group("motion")
    group.add_argument(
        "--time",
        type=Number(SECONDS),
        metavar="S",
        help="robot time including ramps [s]: choose period, harmonics, samples and repeats for it",
    )
    group.add_argument(
        "--harmonics",
        type=Number(ranges.HARMONICS, whole=True),
        metavar="K",
        help="number of harmonics (default: 5, or chosen for --time)",
    )
    group.add_argument(
        "--period",
        type=Number(SECONDS),
        metavar="S",
        help="period [s] (default: the time of a sweep of the joint ranges at full speed)",
    )
    group.add_argument(
        "--optimise-period",
        type=Numbers(SECONDS, (2,), increasing=True),
        metavar="MIN,MAX",
        help="optimise the period within these bounds [s]",
    )
    group.add_argument(
        "--samples",
        type=Number(Range(3, ranges.SAMPLES.upper, "1"), whole=True),
        metavar="N",
        help="samples of the optimiser over one period (default: 20 per harmonic)",
    )
    group.add_argument(
        "--periods",
        type=Number(Range(2, ranges.PERIODS.upper, "1"), whole=True),
        metavar="N",
        help="repeats of the period (default: 2, or as many as fit into --time)",
    )
    group.add_argument(
        "--rate",
        type=Number(HERTZ),
        default=100.0,
        metavar="HZ",
        help="rows per second in trajectory.csv (default %(default)s)",
    )
    group.add_argument(
        "--validation",
        action="store_true",
        help=(
            "design a second, different motion for validating the identified model, in "
            "DIR/validation"
        ),
    )
    group.add_argument(
        "--speed",
        type=Number(SLOWDOWN),
        default=1.0,
        metavar="F",
        help="deliver the motion at F times its speed, for a first careful run",
    )
    group.add_argument(
        "--start",
        type=Numbers(ranges.POSITION),
        metavar="Q1,…,QN",
        help="pose at which the motion starts and ends at rest (default: near the periodic motion)",
    )
    group.add_argument(
        "--box",
        type=NamedNumbers("FRAME:XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX", ":", Numbers(ranges.LENGTH, (6,))),
        metavar="FRAME:XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX",
        action="append",
        default=[],
        help="keep the origin of a frame inside a box [m]",
    )
    group.add_argument(
        "--margin",
        type=Number(Range(0.0, 0.99, "1")),
        metavar="F",
        help=(
            "share of velocity, acceleration, jerk and torque limits to keep free (default: the "
            "limits file's [margin], or 0.02)"
        ),
    )
    group.add_argument(
        "--uncertainty",
        type=Number(Range(0.0, 100.0, "1")),
        default=0.1,
        metavar="R",
        help=(
            "torque limits hold for all robots within this distance of the nominal one (default "
            "%(default)s)"
        ),
    )
    _surroundings(sub)
    group = sub.add_argument_group("search")
    group.add_argument(
        "--starts",
        type=Number(Range(1, 1e6, "1"), whole=True),
        metavar="N",
        help="number of random starts (default: 2, or 4 with --discriminate)",
    )
    group.add_argument(
        "--seed", type=SEED, default=0, metavar="N", help="random seed (default %(default)s)"
    )
    group.add_argument(
        "--jobs",
        type=Number(Range(-1024, 1024, "1", zero=False), whole=True),
        default=-1,
        metavar="N",
        help="number of processes (default: one per core)",
    )
    group.add_argument(
        "--backend",
        choices=("multiprocessing", "loky", "dask", "ray"),
        help="where the starts run (default: processes on this machine)",
    )
    group.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="address of a running Dask scheduler (tcp://host:8786) or Ray head (ray://host:10001)",
    )
    group.add_argument(
        "--iterations",
        type=Number(Range(1, 1e6, "1"), whole=True),
        default=300,
        metavar="N",
        help="largest number of iterations per start (default %(default)s)",
    )
    group.add_argument(
        "--force",
        action="store_true",
        help="write the files even if the certificate fails; they state it",
    )


def _surroundings(sub: argparse.ArgumentParser) -> None:
    group = sub.add_argument_group(
        "surroundings",
        "obstacles around the robot; the shapes of the robot are those of <collision> in the URDF",
    )
    group.add_argument(
        "--scene",
        metavar="FILE",
        help=(
            "TOML: boxes, spheres, capsules, cylinders and meshes around the robot or on its links"
        ),
    )
    floor = group.add_mutually_exclusive_group()
    floor.add_argument(
        "--floor",
        type=Number(ranges.LENGTH),
        metavar="Z",
        help=(
            "height of the floor in the base frame [m] (default: 0, or the lowest point of the "
            "fixed links)"
        ),
    )
    floor.add_argument("--no-floor", action="store_true", help="no floor")
    group.add_argument(
        "--clearance",
        type=Number(Range(0.0, 1e4, "m")),
        metavar="M",
        help="smallest allowed distance [m] (default: that of the scene, or 0.02)",
    )
    group.add_argument(
        "--srdf",
        metavar="FILE",
        help=(
            "SRDF with the pairs of links that may touch (default: adjacent links and pairs that "
            "always touch)"
        ),
    )
    _packages_option(group, ", in addition to ROS_PACKAGE_PATH and the folders of the URDF")
    group.add_argument(
        "--no-collision", action="store_true", help="do not check distances; the files state it"
    )


def _verify(commands: Commands) -> None:
    sub = _command(
        commands, "verify", "recompute every limit and the criterion of a trajectory from its file"
    )
    sub.add_argument("trajectory", metavar="TRAJECTORY", help="path of a trajectory.json")
    _sources(sub)


def _sources(sub: argparse.ArgumentParser) -> None:
    """Add the options of commands that check a trajectory against its source files."""
    group = sub.add_argument_group(
        "sources",
        "present places of the files that the motion was designed with, if they have moved",
    )
    group.add_argument("--robot", metavar="URDF", help="URDF of the robot")
    group.add_argument("--limits", metavar="FILE", help="limits file")
    _packages_option(group)


def _export(commands: Commands) -> None:
    sub = _command(
        commands,
        "export",
        "write a trajectory for a controller, or an identified robot for a simulator",
    )
    sub.add_argument(
        "source",
        metavar="TRAJECTORY_OR_MODEL",
        help="path of a trajectory.json or of a model.json; it decides which formats there are",
    )
    sub.add_argument(
        "--format",
        required=True,
        metavar="F",
        help=(
            "name of a format: csv, json, ros2-joint-trajectory, urscript, …; of a model mjcf, "
            "urdf, sdf, isaaclab, … (see 'excite formats')"
        ),
    )
    sub.add_argument("-o", dest="out", metavar="FILE", required=True, help="file to write")
    sub.add_argument(
        "--rate",
        type=Number(HERTZ),
        metavar="HZ",
        help="rows or knots per second, if the format allows a choice",
    )
    sub.add_argument(
        "--speed",
        type=Number(SLOWDOWN),
        default=1.0,
        metavar="F",
        help="export the motion at F times its speed, for a first careful run",
    )
    group = sub.add_argument_group("identified robot")
    group.add_argument(
        "--into",
        metavar="FILE",
        help="your own MJCF: it is written to -o with what was identified; all else stays",
    )
    group.add_argument(
        "--recording",
        metavar="FILE",
        help="motion along which the torque of what the format cannot hold is stated (default: a "
        "recording of the model, if it is still in its place)",
    )
    _columns_option(group)
    group = sub.add_argument_group("ROS 2")
    group.add_argument(
        "--lead",
        type=Number(ranges.LEAD),
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
            type=Number(ranges.TOLERANCE),
            metavar="RAD",
            help=f"{text}, at every joint (default: the controller's own)",
        )
    _sources(sub)
    sub.add_argument(
        "--force",
        action="store_true",
        help="export a trajectory even if its certificate fails; the file states it",
    )


def _identifiability(commands: Commands) -> None:
    sub = _command(
        commands,
        "identifiability",
        "analyse which parameters a trajectory or a recording makes identifiable",
    )
    _folder_option(sub, "folder for identifiability.json and report.html")
    _robot_options(sub)
    sub.add_argument(
        "motion", metavar="TRAJECTORY_OR_RECORDING", help="a trajectory.json or a recording"
    )
    _recording_options(sub)
    _torque_noise_option(
        _model_options(sub), "that of a trajectory.json, else 1 %% of the torque limit"
    )
    group = sub.add_argument_group("floating base")
    _floating_option(group)
    _rows_option(group, "base")
    _wrench_noise_option(group)


def _identify(commands: Commands) -> None:
    sub = _command(
        commands,
        "identify",
        "estimate physically consistent parameters from recordings, with confidence intervals",
    )
    sub.epilog, sub.formatter_class = RECORDINGS, argparse.RawDescriptionHelpFormatter
    _folder_option(sub, "folder for model.json, identified.urdf, report.html")
    _robot_options(sub)
    sub.add_argument(
        "recordings",
        metavar="RECORDING",
        nargs="+",
        help=(
            "recording that the model is fitted to: CSV, .npz, rosbag2 folder, .mcap, text of ros2 "
            "topic echo or ur_rtde CSV"
        ),
    )
    sub.add_argument(
        "--validate",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="held-out recordings for validation; the model is not fitted to them",
    )
    sub.add_argument(
        "--from",
        dest="source",
        choices=("torque", "position"),
        help="what the model is fitted to: torque, or the measured positions of a robot whose "
        "servos follow qref (default: torque where any was recorded, else position)",
    )
    sub.add_argument(
        "--gains",
        type=Numbers(Range(0.0, 1e9, "N m/rad, N m s/rad")),
        metavar="KP,KD[,…]",
        help="with --from position: gains of the position loop, one pair or one for each joint "
        "(default: estimated; then all torques are ratios to them)",
    )
    _floating_options(sub)
    _model_options(sub)
    group = sub.add_argument_group("signals")
    _band_option(group)
    group.add_argument(
        "--period",
        type=Number(SECONDS),
        metavar="S",
        help="period of the excitation [s], if the recording's .json does not state it",
    )
    group.add_argument(
        "--window",
        type=Numbers(Range(-1e12, 1e12, "s"), (2,), increasing=True),
        metavar="T0,T1",
        help="times between which the motion is periodic, with --period (default: found in the "
        "recording) [s]",
    )
    _recording_options(group)
    group.add_argument(
        "--align",
        action="store_true",
        help="remove the estimated delay of each joint's torque, which the model then states",
    )
    group = sub.add_argument_group("estimation")
    group.add_argument(
        "--estimator",
        choices=("ols", "wls", "full", "huber", "iv"),
        default="wls",
        help=(
            "ordinary least squares; weighted by the noise of each joint; by its covariance; "
            "robust to outliers (Huber); instrumental variables (default %(default)s)"
        ),
    )
    group.add_argument(
        "--distance",
        choices=("riemannian", "bregman", "pullback", "euclidean"),
        default="bregman",
        help="distance of the inertial parameters from the nominal ones (default %(default)s)",
    )
    group.add_argument(
        "--gamma",
        type=WordOrNumbers(("evidence", "heldout"), Numbers(VARIANCE, (1, 2))),
        metavar="G",
        help=(
            "weight of the prior: chosen by evidence, by cross-validation (heldout), a number, "
            "or two numbers for links,joint parameters (default evidence; heldout with --floating)"
        ),
    )
    group.add_argument(
        "--hausman",
        action="store_true",
        help="Hausman test for the bias of least squares; needs the commanded motion, qref.<joint>",
    )
    group.add_argument(
        "--simulate",
        action="store_true",
        help="also validate the model by forward simulation of the positions",
    )
    group.add_argument(
        "--refine",
        action="store_true",
        help="refine the parameters by the error of the simulated positions",
    )
    group.add_argument(
        "--check-lmi",
        action="store_true",
        help="compare the consistent estimate with that of a conic solver (extra [lmi])",
    )
    group.add_argument(
        "--prior",
        metavar="FILE",
        help="trusted parameters: an excite.prior/1 document or a model.json",
    )
    group.add_argument(
        "--bounds",
        metavar="FILE",
        help="TOML with bounds: [links.NAME] mass = [min, max], centre = [[x, y, z], [x, y, z]]",
    )


def _floating_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--floating",
        action="store_true",
        help="the base moves freely: the recording holds its pose (base.x … base.qw) and contact "
        "wrenches (wrench.<frame>.fx … mz, or wrench.world.*)",
    )


def _rows_option(group: argparse._ActionsContainer, default: str) -> None:
    group.add_argument(
        "--rows",
        choices=("base", "joints", "both"),
        help="rows of the equations of motion: the six of the base, those of the joints, or both "
        f"(default: {default})",
    )


def _wrench_noise_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--wrench-noise",
        type=Numbers(Range(1e-9, 1e9, "N, N m"), (2,)),
        metavar="F,M",
        help="standard deviations of contact forces and moments [N, N m] (default: 1 %% of the "
        "robot's weight, and that at 0.1 m)",
    )


def _floating_options(sub: argparse.ArgumentParser) -> None:
    """Add the options of a robot with a floating base."""
    group = sub.add_argument_group("floating base")
    _floating_option(group)
    _rows_option(group, "all that the recordings hold")
    group.add_argument(
        "--symmetric",
        metavar="LEFT:RIGHT",
        help="links whose names begin with these words mirror each other, as left_:right_",
    )
    group.add_argument(
        "--no-wrench-offsets",
        action="store_true",
        help="the sensors of the contact wrenches have no constant offsets",
    )


def _columns_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--columns",
        type=ColumnNames(
            ("q", "dq", "tau", "i", "qref", "qlink", "temp"), ("base", "wrench", "imu")
        ),
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
    sub = _command(
        commands, "predict", "predict the torque along a recording with an identified model"
    )
    sub.add_argument(
        "model", metavar="MODEL", help="model.json of 'excite identify' or 'excite diagnose'"
    )
    sub.add_argument(
        "recording",
        metavar="RECORDING",
        help="recording of the motion, or a designed trajectory.csv",
    )
    sub.add_argument(
        "-o",
        dest="out",
        metavar="FILE.csv",
        required=True,
        help="file for t,tau.<joint>… at the times of the recording; with the model of a floating "
        "base t,wrench.world.fx…",
    )
    _columns_option(sub)


def _diagnose(commands: Commands) -> None:
    sub = _command(
        commands,
        "diagnose",
        "find effects that the base model lacks, with joint, size and probability",
    )
    _folder_option(sub, "folder for diagnosis.json, model.json, report.html")
    _robot_options(sub)
    sub.add_argument(
        "recordings", metavar="RECORDING", nargs="+", help="recordings that the model is fitted to"
    )
    sub.add_argument(
        "--validate",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="held-out recordings for validation (required)",
    )
    sub.add_argument(
        "--discriminating",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="recordings of a motion by 'design --discriminate', fitted like the others; the "
        "report states the odds of each open pair of effects before, expected (with --trajectory) "
        "and after",
    )
    sub.add_argument(
        "--before",
        metavar="DIAGNOSIS",
        help="diagnosis.json of the recordings without the discriminating ones (default: computed)",
    )
    sub.add_argument(
        "--prior",
        metavar="FILE",
        help="what is known: an excite.prior/1 document, or a model.json with its effects",
    )
    _band_option(sub)
    _recording_options(sub)
    sub.add_argument(
        "--no-report",
        action="store_true",
        help="do not write report.html",
    )


def _payload(commands: Commands) -> None:
    sub = _command(
        commands,
        "payload",
        "identify mass, centre of mass and inertia of what is attached to a link",
    )
    _folder_option(sub, "folder for payload.json and report.html")
    _robot_options(sub, payload=False)
    group = sub.add_argument_group("recordings")
    group.add_argument(
        "--with",
        dest="carrying",
        metavar="RECORDING",
        nargs="+",
        required=True,
        help="recordings with the payload",
    )
    group.add_argument(
        "--without",
        dest="empty",
        metavar="RECORDING",
        nargs="+",
        default=[],
        help="recordings of the same robot without it",
    )
    group.add_argument(
        "--model",
        metavar="MODEL",
        help="model.json of the robot without it, in place of --without: its recordings are used",
    )
    _band_option(group)
    _recording_options(group)
    group = sub.add_argument_group("payload")
    group.add_argument(
        "--link", metavar="LINK", help="link or frame that carries it (default: the last link)"
    )
    group.add_argument(
        "--static",
        action="store_true",
        help="use only the poses at rest: mass and centre of mass (implied by the --trajectory of "
        "a static design)",
    )
    group.add_argument(
        "--mass",
        dest="payload_mass",
        type=Number(Range(1e-6, 1e5, "kg")),
        metavar="KG",
        help="its mass, if it was weighed",
    )
    group.add_argument(
        "--shape",
        metavar="SHAPE",
        help="box:X,Y,Z, cylinder:RADIUS,LENGTH, sphere:RADIUS or mesh:FILE, with @CX,CY,CZ if "
        "its centre is known [m]; axes of the link",
    )


def _replay(commands: Commands) -> None:
    sub = _command(
        commands,
        "replay",
        "replay recorded commands in MuJoCo with an identified robot and with its description",
    )
    sub.add_argument(
        "model", metavar="MODEL", help="model.json of 'excite identify' or 'excite diagnose'"
    )
    sub.add_argument(
        "recording", metavar="RECORDING", help="recording with qref.<joint> or tau.<joint>"
    )
    _folder_option(sub, "folder for replay.json and report.html")
    sub.add_argument(
        "--command",
        dest="drive_with",
        choices=("qref", "torque"),
        help="replay the commanded positions through a position loop, or the torque (default: qref "
        "if it was recorded)",
    )
    sub.add_argument(
        "--gains",
        type=Numbers(Range(0.0, 1e9, "N m/rad, N m s/rad")),
        metavar="KP,KD[,…]",
        help="gains of the position loop, one pair or one for each joint (default: those that were "
        "identified with the model, else fitted to the recorded torque)",
    )
    sub.add_argument(
        "--robot", metavar="URDF", help="robot before its identification, if it has moved"
    )
    _columns_option(sub)


def _simulate(commands: Commands) -> None:
    sub = _command(
        commands,
        "simulate",
        "record a simulated robot that follows a trajectory, with effects that its model lacks",
    )
    _robot_argument(sub)
    sub.add_argument(
        "trajectory",
        metavar="TRAJECTORY",
        help="trajectory.json of 'excite design'; with --floating that of a design with --support, "
        "or a CSV file with the columns t, base.x … base.qw, q.<joint>",
    )
    sub.add_argument(
        "-o",
        dest="out",
        metavar="FILE",
        required=True,
        help="CSV file for the recording; .json, .truth.json and .svg are written next to it",
    )
    group = sub.add_argument_group("floating base")
    _floating_option(group)
    group.add_argument(
        "--contact",
        metavar="LINK",
        action="append",
        default=[],
        help="link with a contact sensor; may be repeated (default: all feet of a trajectory.json; "
        "else 'world', the total wrench about the world's origin, without joint torques)",
    )
    _wrench_noise_option(group)
    group.add_argument(
        "--torque-noise",
        type=Numbers(Range(1e-9, 1e9, "N m or N"), (1,)),
        metavar="SIGMA",
        help="standard deviation of the joint torques with --floating [N m] (default: 1 %% of the "
        "torque limit)",
    )
    sub.add_argument(
        "--effect",
        metavar="NAME:JOINT[:k=v,…]",
        action="append",
        default=[],
        help="hidden effect; 'excite effects' lists their names",
    )
    sub.add_argument(
        "--dense",
        type=Number(Range(0.0, 1.0, "1")),
        nargs="?",
        const=1.0,
        metavar="P",
        help=(
            "give every joint several frictions at once, a delay and ripple, as real robots have; "
            "each with probability P (default 1)"
        ),
    )
    sub.add_argument(
        "--severity",
        type=Number(Range(1e-3, 1e6, "1")),
        metavar="S",
        help=(
            "scale each effect to this RMS torque after a refit of the base model, over the "
            "noise RMS"
        ),
    )
    sub.add_argument(
        "--trusted",
        action="store_true",
        help="with --severity: without the refit, as with a trusted prior",
    )
    sub.add_argument(
        "--like",
        metavar="FILE",
        help=".truth.json of another recording: same robot, and effects of the same size",
    )
    sub.add_argument(
        "--seed",
        type=SEED,
        metavar="N",
        help="random seed of the true parameters and of the noise (default 0)",
    )
    sub.add_argument(
        "--model-error",
        type=Number(SHARE),
        metavar="F",
        help="relative deviation of the true link inertial parameters from the URDF (default 0.05)",
    )
    sub.add_argument(
        "--periods",
        type=Number(ranges.PERIODS, whole=True),
        metavar="N",
        help="repeats of the excitation (default: as the trajectory states)",
    )
    group = sub.add_argument_group("measurement")
    group.add_argument(
        "--rate",
        type=Number(Range(125.0, 1000.0, "Hz")),
        metavar="HZ",
        help="sampling rate, 125 to 1000 (default 500), with --floating 200",
    )
    group.add_argument(
        "--noise",
        type=Number(SHARE),
        metavar="F",
        help="standard deviation of the torque noise over the torque limit (default 0.005)",
    )
    group.add_argument(
        "--colour",
        type=Number(HERTZ),
        metavar="HZ",
        help="corner frequency of the noise (default: white noise)",
    )
    group.add_argument(
        "--jitter",
        type=Number(Range(0.0, 1.0, "s")),
        metavar="S",
        help="timestamp jitter: deviation of the sampling times from the recorded times [s]",
    )
    group.add_argument(
        "--encoder",
        type=Number(Range(0.0, 1.0, "rad or m")),
        metavar="RAD",
        help="resolution of the position (default 2e-6)",
    )


def _view(commands: Commands) -> None:
    sub = _command(
        commands, "view", "play a trajectory in a browser, with its surroundings (extra [view])"
    )
    sub.add_argument("trajectory", metavar="TRAJECTORY", help="path of a trajectory.json")
    sub.add_argument("--robot", metavar="URDF", help="URDF of the robot, if it has moved")
    sub.add_argument(
        "--speed",
        type=Number(Range(1e-3, 4.0, "1")),
        default=1.0,
        metavar="F",
        help="play the motion at F times its speed",
    )
    sub.add_argument("--once", action="store_true", help="play the motion once and end")
    sub.add_argument(
        "--host", default="localhost", help="host name of the server (default %(default)s)"
    )
    sub.add_argument(
        "--port",
        type=Number(Range(1, 65535, "1"), whole=True),
        default=8080,
        help="port of the server (default %(default)s, or the next free one)",
    )

"""`excite identify`: estimate physically consistent parameters from recordings."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import api
from .._system.output_files import OutputFiles, output_folder
from .._types import FloatArray
from ..api.saved_identification import IDENTIFICATION_FILES
from ..api.servo_identification_result import lacks_torque
from ..errors import ExciteWarning, UnusableInput
from ..identification.estimators import Method
from ..identification.identification import IdentificationOptions, Prediction
from ..identification.inertia_distance import Distance
from ..identification.torque_delay import MIN_SIGNIFICANCE
from ..recordings import Recording
from ..robot.limits import Limits
from ..robot.parameter_names import some
from ..robot.robot import Robot
from . import floating_identify
from . import options as shared
from .outcome import Outcome, doubt_line, with_files, written_lines

TORQUE_OPTIONS = ("prior", "align", "hausman", "simulate", "refine", "check_lmi", "band")
"""Options that need recorded torque."""
EQUATIONS_PER_PARAMETER = 10
"""Equations per parameter below which a recording counts as short: the lower end of a rule of
thumb, 10 to 20 (Harrell, "Regression Modeling Strategies", 2015, section 4.4)."""


def run(arguments: argparse.Namespace) -> Outcome:
    """Run `excite identify`."""
    if arguments.floating:
        return floating_identify.run(arguments)
    shared.require_floating(arguments, floating_identify.FLOATING_ONLY)
    output = output_folder(Path(arguments.out), IDENTIFICATION_FILES, shared.input_files(arguments))
    robot = shared.robot(arguments)
    limits = shared.limits(arguments, robot)
    recordings = [
        api.read_recording(
            path,
            robot,
            limits=limits,
            period=arguments.period,
            window=arguments.window,
            columns=shared.columns(arguments),
        )
        for path in arguments.recordings
    ]
    if _from_position(arguments, recordings):
        return _run_without_torque(arguments, output, robot, limits, recordings)
    result = api.identify(
        robot,
        recordings,
        validate=arguments.validate,
        limits=limits,
        drive=shared.drive(arguments),
        bounds=arguments.bounds,
        prior=arguments.prior,
        period=arguments.period,
        window=arguments.window,
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        options=_options(arguments),
        check_lmi=arguments.check_lmi,
    )
    document = result.document()
    written = output.replace(result.contents(document))
    tests = (result.identification.endogeneity, result.identification.simulation)
    facts = [test.summary for test in tests if test is not None]
    lmi = result.lmi
    if lmi is not None:
        verdict = "agrees" if lmi.agrees else "DISAGREES"
        facts.append(f"conic solver: {verdict}, objective {lmi.gap:+.2g} relative")
    code = 1 if lmi is not None and not lmi.agrees else 0
    return (
        code,
        with_files(document, written),
        _text(result, facts, written),
    )


def _from_position(arguments: argparse.Namespace, recordings: Sequence[Recording]) -> bool:
    """Return True if the model is fitted to positions, as asked or because there is no torque.

    Raises:
        UnusableInput: Options of the identification from torque are given.
    """
    if arguments.source == "torque":
        return False
    if arguments.source is None:
        if not all(map(lacks_torque, recordings)):
            if arguments.gains is not None:
                raise UnusableInput("--gains: holds for --from position; add it")
            return False
        warnings.warn(
            "no torque was recorded: identifying from commanded and measured positions "
            "(--from position), in units of the servo gain",
            ExciteWarning,
            stacklevel=2,
        )
    given = [name for name in TORQUE_OPTIONS if getattr(arguments, name)]
    if given:
        raise UnusableInput(f"--{given[0].replace('_', '-')}: needs recorded torque; leave it out")
    return True


def _run_without_torque(
    arguments: argparse.Namespace,
    output: OutputFiles,
    robot: Robot,
    limits: Limits,
    recordings: Sequence[Recording],
) -> Outcome:
    """Identify from commanded and measured positions."""
    result = api.identify_servo(
        robot,
        recordings,
        validate=arguments.validate,
        limits=limits,
        drive=shared.drive(arguments),
        bounds=arguments.bounds,
        gains=arguments.gains,
        trajectory=arguments.trajectory,
        columns=shared.columns(arguments),
        distance=Distance(arguments.distance),
        gamma=_stated_gamma(arguments),
    )
    document, written = result.document(), output.replace(result.contents())
    identification = result.identification
    replays = identification.validations or identification.fits
    lines = [
        f"{robot.name}: identified from positions; {identification.scale_statement}",
        f"{'held out' if identification.validations else 'on the data fitted (no --validate)'}: "
        "position error of a simulation of the complete recording [rad or m]",
        f"{'joint':25}{'commanded':>11}{'simulated':>11}{'Kp':>11}{'coulomb/Kp':>12}",
    ]
    for replay in replays:
        if len(replays) > 1:
            lines.append(replay.source)
        for j, joint in enumerate(robot.joints):
            errors = replay.error("command")[j], replay.error()[j]
            gain = identification.loop.proportional[j]
            ratio = document["over_gain"][joint].get("coulomb", float("nan"))
            spread = document["over_gain_std"][joint].get("coulomb", float("nan"))
            lines.append(
                f"{joint:25} {errors[0]:10.4g} {errors[1]:10.4g} {gain:10.4g} {ratio:11.4g} "
                f"± {spread:.2g}"
            )
    return 0, with_files(document, written), "\n".join([*lines, *written_lines(written)])


def _stated_gamma(arguments: argparse.Namespace) -> tuple[float, float] | None:
    """Weights of the inertial and of the joint parameters; None: not stated as numbers."""
    gamma = arguments.gamma
    return None if gamma is None or isinstance(gamma, str) else (gamma[0], gamma[-1])


def _options(arguments: argparse.Namespace) -> IdentificationOptions:
    return IdentificationOptions(
        method=Method(arguments.estimator),
        distance=Distance(arguments.distance),
        gamma=_stated_gamma(arguments) or arguments.gamma or "evidence",
        band=arguments.band,
        threshold=arguments.threshold,
        align=arguments.align,
        hausman=arguments.hausman,
        simulate=arguments.simulate,
        refine=arguments.refine,
    )


def _text(result: api.IdentificationResult, facts: Sequence[str], written: Sequence[Path]) -> str:
    identification = result.identification
    robot = identification.model.robot
    predictions = identification.validations or identification.fits
    lines = [
        f"{robot.name}: {identification.analysis.identifiable_count} of "
        f"{identification.model.base.count} directions identified with the noise of the recording "
        f"({result.assumed_count} with the 1 % of the torque limits that a design assumes); "
        f"band {identification.spectra.hertz:.3g} Hz",
        f"{'held out' if identification.validations else 'on the data fitted (no --validate)'}: "
        f"torque error per joint{'' if all(p.moving.all() for p in predictions) else ' in motion'}",
        f"{'joint':25}{'nominal':>11}{'identified':>12}{'noise':>11}{'relative':>10}",
    ]
    for prediction in predictions:
        if len(predictions) > 1:
            lines.append(prediction.source)
        for i, joint in enumerate(robot.joints):
            floor = "" if prediction.noise_floor is None else f"{prediction.noise_floor[i]:.4g}"
            before, after, share = (
                prediction.error("nominal")[i],
                prediction.error()[i],
                prediction.relative()[i],
            )
            percent = f"{100 * share:.{2 if share < 10.0 else 0}f}%" if np.isfinite(share) else "-"
            lines.append(f"{joint:25} {before:10.4g} {after:11.4g} {floor:>10} {percent:>9}")
    lines += [_summary(prediction, robot) for prediction in predictions]
    if worse := identification.worsened_joints():
        remark = (
            f"{some(worse)}: the nominal robot predicts the held-out torque better than the "
            "identified one"
        )
        # doubts about the recordings contain the remedy
        lines.append(remark if result.doubts else f"{remark}; {_advice(result, predictions)}")
    common, spread = identification.delay.common
    if abs(common) > MIN_SIGNIFICANCE * spread and not identification.options.align:
        order = "after" if common > 0 else "before"
        lines.append(
            f"torque fits best {abs(1e3 * common):.3g} ms {order} position on average: a delay of "
            "the recording (--align removes it), or friction that builds up after reversals"
        )
    if result.doubts:
        lines.append(doubt_line(result.doubts, "model"))
    return "\n".join([*lines, *facts, *written_lines(written)])


def _advice(result: api.IdentificationResult, predictions: Sequence[Prediction]) -> str:
    """Return a remedy for a model that predicts worse than the nominal robot."""
    identification = result.identification
    equations = int(identification.equations.moving.sum())
    excited = len(identification.data.information_root)
    if equations < EQUATIONS_PER_PARAMETER * excited:
        return f"{equations} equations are few for {excited} parameters: record for longer"
    if any(_percent_of_torque(p, p.fitted) > 100.0 for p in predictions):
        return (
            "over all joints the error exceeds the torque: check signs, gravity and units of all "
            "recordings (positions in rad, not in turns or degrees)"
        )
    return "try a lower --band or record a motion that excites more"


def _percent_of_torque(prediction: Prediction, torque: FloatArray) -> float:
    """Error of predicted torque over the measured torque, of all joints in motion [%]."""
    counted = prediction.moving
    size = float(np.linalg.norm(prediction.measured[counted]))
    error = float(np.linalg.norm((prediction.measured - torque)[counted]))
    return 100.0 * error / size if size else 0.0


def _summary(prediction: Prediction, robot: Robot) -> str:
    """Error of all joints before and after, and the joint that limits it."""
    before, after = (
        _percent_of_torque(prediction, torque) for torque in (prediction.nominal, prediction.fitted)
    )
    joint, above = prediction.limiting_joint()
    name, error = robot.joints[joint], prediction.error()[joint]
    unit = robot.entries[joint].unit("N m")
    if above and prediction.noise_floor is not None and prediction.noise_floor[joint] > 0.0:
        place = (
            f"largest over its torque at {name}, {error / prediction.noise_floor[joint]:.2g} times "
            "its noise floor"
        )
    elif prediction.noise_floor is not None and not above:
        place = "every joint is at its noise floor"
    else:
        place = f"largest at {name}, {error:.3g} {unit}"
    return f"all joints: {before:.3g} % of the torque before, {after:.3g} % after; {place}"

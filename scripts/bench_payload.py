"""Error and coverage of `excite payload` on simulated payloads, compared with usual estimates.

    python scripts/bench_payload.py [--count 30] [--robots ur5e fr3 iiwa14] [--dense | --static]

Each robot carries payloads of 0.02 to 0.5 of its rating, eccentric, with load friction hidden at
every joint (with --dense, all frictions of a dense robot). The robot is recorded with and without
each payload, along a motion of 20 s by `excite design --for-payload`; each recording has noise of
its own. The static estimate uses the torque of four poses at rest, each with any friction that rest
allows; the plain difference subtracts the torque without payload from that with it, without a model
of friction. On standard error: the predicted standard deviation of the motion, in the metric of a
ball, next to that of sines of the last three joints of the same duration.

With --static, the payload is found from the poses of `excite design --for-payload LINK --static`,
each reached from both sides. Friction at rest keeps the direction of the arrival; its size is that
of Coulomb and load friction, and scatters by a tenth of the former from rest to rest. The simulator
has no friction at rest, so that the torques are those of the links with this friction.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excite import _json, design, design_static
from excite._types import FloatArray
from excite.api.design_result import DesignResult
from excite.api.identification_result import REFERENCE_RATE
from excite.api.robots import resolve_limits
from excite.designer.payload_weighting import payload_deviation
from excite.identification import segments
from excite.identification.regression import IdentificationModel
from excite.payload.equations import (
    PayloadEquations,
    PayloadPlace,
    build_payload_equations,
    payload_place,
)
from excite.payload.estimate import PayloadEstimate, estimate_payload
from excite.payload.static import Rests, estimate_static_payload
from excite.recordings import Recording, Sidecar
from excite.robot import base_parameters, inertial_parameters
from excite.robot.dynamics import regressor
from excite.robot.inertial_parameters import COULOMB_WIDTH
from excite.robot.robot import Payload, Robot, load, locate
from excite.robot.samples import Samples
from excite.simulator.dense_robot import dense_effects
from excite.simulator.effect_instance import EffectInstance, with_effects
from excite.simulator.effects.load import AttachedBody
from excite.simulator.experiment import ExperimentSettings, build_robot, measurement_chain
from excite.simulator.recording_file import measure
from excite.simulator.reference_trajectory import ReferenceTrajectory, read_reference
from excite.simulator.simulated_robot import SimulatedMotion, SimulatedRobot

RATINGS = {"ur5e": 5.0, "fr3": 3.0, "iiwa14": 14.0, "ur10e": 12.5, "panda": 3.0, "tx40": 2.3}
"""Rated payload of each robot [kg]."""
SHARES = (0.02, 0.5)
"""Smallest and largest payload over the rating."""
LARGEST_OFFSET = 0.1
"""Largest coordinate of the centre of mass [m]."""
RADII = (0.02, 0.06)
"""Smallest and largest radius of gyration along each axis [m]."""
LOAD_FRICTION = (0.03, 0.15)
"""Smallest and largest coefficient of load friction."""
STATIC_POSES = 4
"""Poses of the static estimate."""
WIGGLE_AMPLITUDE = 0.5
"""Amplitude of each joint of a wrist wiggle [rad]."""
WIGGLE_HERTZ = (0.4, 0.6, 0.8)
"""Frequencies of its three joints [Hz]."""
REST_SCATTER = 0.1
"""Standard deviation of the friction from rest to rest, over the Coulomb friction [1]."""
REST_SECONDS = 0.75
"""Time over which the torque of a rest is averaged [s]."""
MOTION_SECONDS = 20.0
"""Robot time of each recording [s]."""


@dataclass(frozen=True)
class CaseScore:
    """Errors of one payload.

    Attributes:
        mass: True mass [kg].
        errors: Relative mass error of this tool, the static estimate and the plain difference.
        centres: Error of the centre of mass of the three [m].
        covered: Whether each 95 % interval of mass and centre covers the truth. Shape (4,).
        shown: Whether mass and centre were shown. Shape (4,).
        seconds: Time of the estimate [s].
    """

    mass: float
    errors: tuple[float, float, float]
    centres: tuple[float, float, float]
    covered: tuple[bool, ...]
    shown: tuple[bool, ...]
    seconds: float


@dataclass(frozen=True)
class WiggleComparison:
    """Predicted standard deviations of a payload in the metric of a ball, friction eliminated.

    Attributes:
        designed: Of the designed motion.
        wiggle: Of a motion of the last three joints alone, of the same duration.
    """

    designed: float
    wiggle: float

    @property
    def text(self) -> str:
        """One line."""
        ratio = self.designed / self.wiggle
        return (
            f"metric standard deviation {self.designed:.3g}, wrist wiggle {self.wiggle:.3g}: "
            f"{ratio:.3f} (at most 1/3 asked)"
        )


def compare_with_wiggle(result: DesignResult, link: str) -> WiggleComparison:
    """Compare a designed motion with sines of the last three joints about its centre."""
    machine, motion = result.robot, result.trajectory.motion
    assert result.payload is not None
    t = motion.grid(REFERENCE_RATE)
    amplitude, rate = np.zeros(machine.n), np.zeros(machine.n)
    amplitude[-3:], rate[-3:] = WIGGLE_AMPLITUDE, 2.0 * np.pi * np.array(WIGGLE_HERTZ)
    phase = np.outer(t, rate)
    wiggle = Samples(
        motion.fourier.offset + amplitude * np.sin(phase),
        amplitude * rate * np.cos(phase),
        -amplitude * rate**2 * np.sin(phase),
    )
    noise = np.asarray(result.trajectory.noise, float)
    other = payload_deviation(machine, result.parameters, wiggle, noise, link)
    return WiggleComparison(result.payload.metric, other.metric)


def identification_model(machine: Robot) -> IdentificationModel:
    """Return the model whose parameters are estimated."""
    table = resolve_limits(machine, None)
    standard = inertial_parameters.standard_parameters(machine, table)
    base = base_parameters.find(machine, standard, table)
    return IdentificationModel(machine, standard, base, np.full(machine.n, COULOMB_WIDTH))


class Laboratory:
    """A simulated robot that is recorded with and without payloads."""

    def __init__(self, name: str, is_dense: bool) -> None:
        self.name = name
        self.reference, self.comparison = payload_motion(name)
        self.settings = ExperimentSettings(seed=3)
        robot = build_robot(locate(name), self.reference, self.settings)
        rng = np.random.default_rng(11)
        effects = (
            dense_effects(robot, self.reference, 1.0, 5)
            if is_dense
            else tuple(
                EffectInstance("load_friction", j, "tuning", {"mu": rng.uniform(*LOAD_FRICTION)})
                for j in robot.joints
            )
        )
        self.robot: SimulatedRobot = with_effects(robot, effects)
        self.machine = load(name)
        self.model = identification_model(self.machine)
        self.link = self.machine.links[-1]
        self.place = payload_place(self.machine, self.link)
        self.chain = measurement_chain(self.robot, self.settings)
        self.empty = self.robot.follow(self.reference)

    def carrying(self, body: AttachedBody) -> SimulatedMotion:
        """Simulate the robot with a payload."""
        robot = dataclasses.replace(self.robot, effects=(*self.robot.effects, body))
        return robot.follow(self.reference)

    def record(self, motion: SimulatedMotion, seed: int) -> Recording:
        """Record a simulated motion with noise of its own."""
        signals = measure(motion, self.reference, self.chain, np.random.default_rng([7, seed]))
        sidecar = Sidecar(period=signals.period, periodic=signals.periodic)
        return Recording(
            f"{seed}.csv",
            self.machine.joints,
            signals.t,
            signals.q,
            tau=signals.tau,
            sidecar=sidecar,
            row_times=signals.t,
        )

    def equations(self, carrying: Recording, without: Recording) -> PayloadEquations:
        """Build the equations of a recording with payload and one without."""
        groups = [list(segments.extract_segments([carrying]))]
        empty = list(segments.extract_segments([without]))
        hertz = segments.torque_spectra(groups[0]).hertz
        return build_payload_equations(self.model, self.place, groups, empty, hertz)


def with_largest_payload(name: str) -> tuple[Robot, str]:
    """Return a robot for whose payload motions are designed, and the link that carries it."""
    mass = SHARES[1] * RATINGS[name]
    link = load(name).links[-1]
    centre = (0.8 * LARGEST_OFFSET,) * 3
    return load(name, payload=Payload(link, mass, centre, (0.01, 0, 0.01, 0, 0, 0.01))), link


def payload_motion(name: str) -> tuple[ReferenceTrajectory, WiggleComparison]:
    """Design a motion for payloads up to the largest one, with `excite design --for-payload`, and
    compare it with a wrist wiggle."""
    carrying, link = with_largest_payload(name)
    result = design(carrying, time=MOTION_SECONDS, payload_link=link, starts=2, jobs=1)
    document = result.trajectory.document()
    document["robot"]["payload"] = None  # the simulated robot gets one in each case
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trajectory.json"
        path.write_text(_json.dumps(document), encoding="utf-8")
        return read_reference(path), compare_with_wiggle(result, link)


def draw_payload(name: str, link: str, rng: np.random.Generator, share: float) -> AttachedBody:
    """Draw an eccentric payload."""
    x, y, z = rng.uniform(-LARGEST_OFFSET, LARGEST_OFFSET, 3).tolist()
    radii = tuple(rng.uniform(*RADII, 3).tolist())
    mass = share * RATINGS[name]
    return AttachedBody(link, mass, (x, y, z), radii)  # type: ignore[arg-type]


def plain_difference(equations: PayloadEquations) -> FloatArray:
    """Return mass and first moments by the difference of the mean torques, without friction."""
    inside = equations.recording >= 0
    count = min(int(inside.sum()), int((~inside).sum()))
    torque = equations.equations.torque
    difference = torque[inside][:count] - torque[~inside][:count]
    columns = equations.payload_columns()[inside][:count]
    solution = np.linalg.lstsq(columns.reshape(-1, 10), difference.ravel(), rcond=None)[0]
    return np.asarray(solution[:4])


def static_estimate(lab: Laboratory, body: AttachedBody, rng: np.random.Generator) -> FloatArray:
    """Return mass and first moments by the torque of four poses at rest.

    Friction at rest is anything up to Coulomb friction, drawn evenly.
    """
    t = np.linspace(0.0, lab.reference.duration, STATIC_POSES + 2)[1:-1]
    columns = gravity_columns(lab.model, lab.place, lab.reference.at(t)[0])
    truth = body.mass * np.array([1.0, *body.centre])
    friction = lab.robot.actuators.coulomb * rng.uniform(-1.0, 1.0, (2, *columns.shape[:2]))
    torque = columns @ truth + friction[1] - friction[0]
    return np.asarray(np.linalg.lstsq(columns.reshape(-1, 4), torque.ravel(), rcond=None)[0])


def gravity_columns(model: IdentificationModel, place: PayloadPlace, q: FloatArray) -> FloatArray:
    """Return the columns of mass and first moments of a payload at rest, shape (N, n, 4)."""
    still = np.zeros_like(q)
    Y = regressor(model.robot, model.parameters, Samples(q, still, still))
    start = 10 * place.body
    return np.asarray(Y[:, :, start : start + 10] @ place.frame[:, :4])


class StaticLaboratory:
    """A robot that rests in designed poses, with and without payloads."""

    def __init__(self, name: str) -> None:
        self.name = name
        carrying, self.link = with_largest_payload(name)
        result = design_static(carrying, self.link)
        machine = load(name)
        self.model = identification_model(machine)
        self.place = payload_place(machine, self.link)
        self.q = np.repeat(result.design.poses, 2, axis=0)
        self.arrival = np.tile([[-1.0], [1.0]], (len(result.design.poses), machine.n))
        path, settings = locate(name), ExperimentSettings(seed=3)
        joints = machine.joints
        still = ReferenceTrajectory(joints, lambda t: (t, t, t), 0.0, 1.0, (0.0, 1.0), {})
        self.robot = build_robot(path, still, settings)
        self.load_friction = np.random.default_rng(11).uniform(*LOAD_FRICTION, machine.n)
        chain = measurement_chain(self.robot, settings)
        self.noise = chain.noise / np.sqrt(chain.rate * REST_SECONDS)

    def rests(self, body: AttachedBody | None, rng: np.random.Generator) -> Rests:
        """Return the mean torques of the rests."""
        robot = self.robot if body is None else dataclasses.replace(self.robot, effects=(body,))
        still, actuators = np.zeros_like(self.q), robot.actuators
        links = robot.dynamics().inverse_dynamics(self.q, still, still)
        friction = actuators.coulomb + self.load_friction * np.abs(links)
        friction = friction + REST_SCATTER * actuators.coulomb * rng.standard_normal(self.q.shape)
        noise = self.noise * rng.standard_normal(self.q.shape)
        torque = links + actuators.offset + self.arrival * friction + noise
        return Rests("empty" if body is None else "carrying", self.q, torque, self.arrival)


def score_static_case(lab: StaticLaboratory, number: int, share: float) -> CaseScore:
    """Estimate a payload from rests, next to one arrival at four of the poses and to the difference
    of all mean torques."""
    rng = np.random.default_rng([17, number])
    body = draw_payload(lab.name, lab.link, rng, share)
    carrying, empty = lab.rests(body, rng), lab.rests(None, rng)
    start = time.perf_counter()
    result = estimate_static_payload(lab.model, lab.place, [carrying], [empty])
    seconds = time.perf_counter() - start
    columns = gravity_columns(lab.model, lab.place, lab.q)
    # the friction of one arrival has the same direction with and without the payload
    difference = carrying.torque - empty.torque
    rough = [
        np.linalg.lstsq(columns[rows].reshape(-1, 4), difference[rows].ravel(), rcond=None)[0]
        for rows in (slice(0, 2 * STATIC_POSES, 2), slice(None))
    ]
    return scored(body, result, rough, seconds)


def score_case(lab: Laboratory, number: int, share: float) -> CaseScore:
    """Record a payload and compare the three estimates with it."""
    rng = np.random.default_rng([17, number])
    body = draw_payload(lab.name, lab.link, rng, share)
    recording = lab.record(lab.carrying(body), 100 + number)
    without = lab.record(lab.empty, 1000 + number)
    start = time.perf_counter()
    equations = lab.equations(recording, without)
    result: PayloadEstimate = estimate_payload(equations)
    seconds = time.perf_counter() - start
    rough = [static_estimate(lab, body, rng), plain_difference(equations)]
    return scored(body, result, rough, seconds)


def scored(
    body: AttachedBody, result: PayloadEstimate, rough: Sequence[FloatArray], seconds: float
) -> CaseScore:
    """Compare an estimate and two rough ones, mass and first moments, with the truth."""
    truth = np.array([body.mass, *body.centre])
    estimates = [
        np.array([result[name].value for name in NAMES]),
        *(np.array([x[0], *(x[1:] / x[0])]) for x in rough),
    ]
    distances = [np.linalg.norm(x[1:] - truth[1:]) for x in estimates]
    quantities = [result[name] for name in NAMES]
    return CaseScore(
        body.mass,
        tuple(abs(x[0] / truth[0] - 1.0) for x in estimates),  # type: ignore[arg-type]
        tuple(float(v) for v in distances),  # type: ignore[arg-type]
        tuple(
            q.interval[0] <= value <= q.interval[1]
            for q, value in zip(quantities, truth, strict=True)
        ),
        tuple(q.shown for q in quantities),
        seconds,
    )


NAMES = ("mass", "centre_x", "centre_y", "centre_z")
"""Quantities that are compared."""


def report(name: str, scores: Sequence[CaseScore]) -> str:
    """Return a row of the table."""
    errors = 100.0 * np.median([score.errors for score in scores], axis=0)
    centres = 1e3 * np.median([score.centres for score in scores], axis=0)
    covered = [c for s in scores for c, shown in zip(s.covered, s.shown, strict=True) if shown]
    shown = np.mean([score.shown for score in scores])
    cells = [
        f"{errors[0]:.2f} / {errors[1]:.1f} / {errors[2]:.1f} %",
        f"{centres[0]:.2f} / {centres[1]:.1f} / {centres[2]:.1f} mm",
        f"{100.0 * np.mean(covered):.1f} % of {len(covered)}",
        f"{100.0 * shown:.0f} %",
        f"{np.median([score.seconds for score in scores]):.1f}",
    ]
    return f"| {name} | {len(scores)} | {' | '.join(cells)} |"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=30, help="payloads of each robot (default 30)")
    parser.add_argument("--robots", nargs="+", default=["ur5e", "fr3", "iiwa14"], choices=RATINGS)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--dense", action="store_true", help="all frictions of a dense robot")
    kind.add_argument("--static", action="store_true", help="poses at rest instead of a motion")
    arguments = parser.parse_args(argv)
    print(
        "| robot | payloads | median mass error: this / static / difference | centre | covered by "
        "95 % intervals | shown | s |\n|---|---|---|---|---|---|---|"
    )
    together = list[CaseScore]()
    for name in arguments.robots:
        shares = np.linspace(*SHARES, arguments.count).tolist()
        if arguments.static:
            rests = StaticLaboratory(name)
            scores = [score_static_case(rests, k, share) for k, share in enumerate(shares)]
        else:
            lab = Laboratory(name, arguments.dense)
            scores = [score_case(lab, k, share) for k, share in enumerate(shares)]
            print(f"{name}: {lab.comparison.text}", file=sys.stderr, flush=True)
        together += scores
        print(report(name, scores), flush=True)
    print(report("all", together))
    return 0


if __name__ == "__main__":
    sys.exit(main())

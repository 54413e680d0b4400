"""Replay of recorded commands in MuJoCo with an exported robot.

The command is the recorded torque, or the commanded position through a position loop
u = a τ_rigid(q_ref) + K_p e + K_d ė + K_i ∫e + c, e = q_ref − q, whose gains are stated or fitted
to the recorded torque, joint by joint, with K_p, K_d, K_i ≥ 0. The motor's torque follows u with a
first-order lag.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects import friction_runtime
from ..errors import UnusableInput
from ..identification.identified_model import IdentifiedModel
from ..recordings import Recording
from ..robot.samples import Samples
from ..schemas.effects import is_recording_filter
from . import mjcf_file
from .python_friction import friction_table
from .simulator_model import SimulatorModel

HORIZONS = (0.1, 0.3, 1.0)
"""Lengths of the windows that start from the recorded state [s]."""
MAX_WINDOWS = 20
"""Largest number of windows of each length, evenly spread over the recording."""
LOST_DISTANCE = 1.0
"""Distance from the recording at which a simulation counts as lost, and as which it then counts
[rad or m]."""
SATURATION_SHARE = 0.98
"""Share of its limit from which torque counts as saturated."""
LARGEST_LAG = 0.03
"""Largest time by which the recorded torque is sought behind the command of the loop [s]."""
SATURATION_MARGIN = 0.05
"""Time around saturated torque that is not fitted, as the low-pass filter smears it [s]."""
MIN_SEGMENT_ROWS = 50
"""Smallest number of rows of a recording that is replayed."""


@dataclass(frozen=True)
class PositionLoop:
    """Position loop of each joint.

    Attributes:
        forward: Factor a of the rigid torque of the commanded motion. Shape (n,).
        gains: K_p, K_d, K_i. Shape (3, n) [N m/rad, N m s/rad, N m/(rad s)].
        constant: Constant c. Shape (n,) [N m].
        delay: Time by which the command acts late. Shape (n,) [s].
        error_limit: Position error at which the motor saturates, ∞ without. Shape (n,) [rad or m].
        lag: Time constant with which the motor's torque follows the loop. Shape (n,) [s].
        explained: Share of the variance of the recorded torque that the loop explains, shape (n,);
            None for gains that are stated or part of the model.
        origin: How the loop is known: "fitted", "stated" or "model".
    """

    forward: FloatArray
    gains: FloatArray
    constant: FloatArray
    delay: FloatArray
    error_limit: FloatArray
    lag: FloatArray
    explained: FloatArray | None = None
    origin: str = "fitted"

    def document(self, joints: Sequence[str]) -> dict[str, Any]:
        """Content for JSON."""
        keys = ("proportional", "derivative", "integral")
        return {
            joint: {
                "forward": float(self.forward[j]),
                **{key: float(self.gains[k, j]) for k, key in enumerate(keys)},
                "constant": float(self.constant[j]),
                "delay": float(self.delay[j]),
                "lag": float(self.lag[j]),
                "explained": None if self.explained is None else float(self.explained[j]),
            }
            for j, joint in enumerate(joints)
        }


@dataclass(frozen=True)
class ReplayInput:
    """A gap-free stretch of a recording, filtered, with its command.

    Attributes:
        t: Times from 0. Shape (N,) [s].
        q: Positions as recorded. Shape (N, n) [rad or m].
        motion: Recorded motion, low-passed.
        reference: Commanded motion, low-passed; None: the command is the torque.
        torque: Torque as recorded; None: not recorded. Shape (N, n) [N m].
        smooth_torque: The same, low-passed like the motion.
        rigid: Torque of links and rotors of the commanded motion. Shape (N, n) [N m].
        torque_delay: Time by which torque is recorded late. Shape (n,) [s].
    """

    t: FloatArray
    q: FloatArray
    motion: Samples
    reference: Samples | None
    torque: FloatArray | None
    smooth_torque: FloatArray | None
    rigid: FloatArray
    torque_delay: FloatArray


@dataclass(frozen=True)
class ReplayRun:
    """A simulation from one recorded state.

    Attributes:
        q: Positions at the rows of the recording. Shape (N, n) [rad or m].
        torque: Torque of the motors. Shape (N, n) [N m].
    """

    q: FloatArray
    torque: FloatArray


def replay_input(model: IdentifiedModel, recording: Recording, use_torque: bool) -> ReplayInput:
    """Prepare the longest gap-free stretch of a recording.

    Args:
        model: The identified robot.
        recording: The recording.
        use_torque: Whether the command is the recorded torque.

    Raises:
        UnusableInput: The recording is too short or lacks the command.
    """
    part = max(recording.segments(), key=len, default=None)
    if part is None or len(part) < MIN_SEGMENT_ROWS:
        raise UnusableInput(f"{recording.source}: has no gap-free stretch to replay; record again")
    if part.qref is None and not use_torque:
        raise UnusableInput(
            f"{recording.source}: has no qref.<joint> columns to replay; record the commanded "
            "positions, or replay the torque with --command torque"
        )
    torque = part.tau
    if use_torque and torque is None:
        raise UnusableInput(
            f"{recording.source}: has no torque to replay; record tau.<joint>, or replay qref"
        )
    motion, reference = part.samples(), None
    if not use_torque and part.qref is not None:
        if not np.isfinite(part.qref).all():
            joint = part.joints[int(np.argmin(np.isfinite(part.qref).all(axis=0)))]
            raise UnusableInput(
                f"{recording.source}: joint '{joint}' has no qref; record the commanded positions "
                "of all joints, or replay the torque with --command torque"
            )
        reference = dataclasses.replace(part, q=part.qref).samples()
    rigid = np.zeros_like(motion.q) if reference is None else rigid_torque(model, reference)
    smooth = None if torque is None else dataclasses.replace(part, q=torque).samples().q
    return ReplayInput(
        part.t - part.t[0],
        part.q,
        motion,
        reference,
        torque,
        smooth,
        rigid,
        recording_delay(model),
    )


def recording_delay(model: IdentifiedModel) -> FloatArray:
    """Return the time by which a model finds torque recorded late. Shape (n,) [s]."""
    delay = np.zeros(model.robot.n)
    for effect in model.effects:
        if effect.effect == "delay" and not is_recording_filter(effect.values):
            delay[effect.joint_index(model.robot.joints)] += max(float(effect.coefficients[0]), 0.0)
    return delay


def rigid_torque(model: IdentifiedModel, motion: Samples) -> FloatArray:
    """Return the torque of links and rotors along a motion. Shape (N, n) [N m]."""
    psi = model.psi.copy()
    for kind in ("viscous", "coulomb", "offset"):
        if kind in model.drive:
            psi[model.layout.block(kind)] = 0.0
    return dataclasses.replace(model, psi=psi).torque(motion, motion.dq)


def fit_position_loop(data: ReplayInput, limit: FloatArray, source: str) -> PositionLoop:
    """Fit the position loop of each joint to the recorded torque below its limit.

    Both sides of the equation pass the same low-pass filter. The recorded torque may lie behind the
    command of the loop, by the time that fits best; what the recording itself is late is no lag of
    the loop. At its torque limit the controller is not linear; its integrator is taken to be held
    there.

    Args:
        data: The recording with commanded positions.
        limit: Torque limits, infinite without. Shape (n,) [N m].
        source: Name of the recording, for messages.

    Raises:
        UnusableInput: No torque was recorded.
    """
    from scipy import optimize  # slow to import

    if data.torque is None or data.reference is None or data.smooth_torque is None:
        raise UnusableInput(
            f"{source}: has no torque to fit the position loop to; state it with --gains KP,KD"
        )
    n = data.q.shape[1]
    is_free = np.abs(data.torque) < SATURATION_SHARE * limit
    terms = _loop_terms(data, is_free)
    fits = []
    for j in range(n):
        rows = _without_neighbours(is_free[:, j], data.t) & (data.t > LARGEST_LAG)
        signals, torque = terms[:, :, j], data.smooth_torque[rows, j]

        def fit(
            late: float,
            signals: FloatArray = signals,
            rows: BoolArray = rows,
            torque: FloatArray = torque,
        ) -> _LoopFit:
            times = data.t[rows] - late
            columns = np.column_stack([np.interp(times, data.t, x) for x in signals.T])
            return _LoopFit.of(np.column_stack([columns, np.ones(len(times))]), torque, late)

        late = optimize.minimize_scalar(
            lambda late, fit=fit: fit(late).square, bounds=(0.0, LARGEST_LAG), method="bounded"
        ).x
        fits.append(fit(float(late)))
    x = np.array([fit.coefficients for fit in fits]).T
    lag = np.maximum([fit.late for fit in fits] - data.torque_delay, 0.0)
    never, explained = np.full(n, np.inf), np.array([fit.explained for fit in fits])
    return PositionLoop(x[0], x[1:4], x[4], np.zeros(n), never, lag, explained)


def loop_torque(loop: PositionLoop, data: ReplayInput) -> FloatArray:
    """Return the torque that a loop commands along a recording. Shape (N, n) [N m].

    Args:
        loop: The loop; its integrator is not held at the torque limit.
        data: The recording, with commanded positions.
    """
    terms = _loop_terms(data, np.ones(data.q.shape, bool))
    gains = np.concatenate([loop.forward[None], loop.gains])
    return np.asarray(np.einsum("tkj,kj->tj", terms, gains) + loop.constant)


def _loop_terms(data: ReplayInput, is_free: BoolArray) -> FloatArray:
    """Signals of the loop: τ_rigid(q_ref), e, ė and ∫e. Shape (N, 4, n)."""
    assert data.reference is not None
    error = data.reference.q - data.motion.q
    rate = data.reference.dq - data.motion.dq
    return np.stack([data.rigid, error, rate, _integral(error * is_free, data.t)], axis=1)


def _without_neighbours(is_free: BoolArray, t: FloatArray) -> BoolArray:
    """Rows that are farther than `SATURATION_MARGIN` from saturated ones. Shape (N,)."""
    reach = int(np.ceil(SATURATION_MARGIN / float(np.median(np.diff(t)))))
    near = np.convolve(~is_free, np.ones(2 * reach + 1), mode="same") > 0.5
    return is_free if near.all() else ~near


@dataclass(frozen=True)
class _LoopFit:
    """Fit of the loop of one joint.

    Attributes:
        coefficients: a, K_p, K_d, K_i, c. Shape (5,).
        late: Time by which the torque lies behind the loop [s].
        square: Sum of the squared residuals [(N m)²].
        explained: Share of the variance of the torque that the loop explains.
    """

    coefficients: FloatArray
    late: float
    square: float
    explained: float

    @classmethod
    def of(cls, columns: FloatArray, torque: FloatArray, late: float) -> _LoopFit:
        """Fit nonnegative gains to torque, shapes (M, 5) and (M,)."""
        from scipy import optimize  # slow to import

        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        low = np.array([-np.inf, 0.0, 0.0, 0.0, -np.inf])
        x = optimize.lsq_linear(columns / size, torque, (low, np.full(5, np.inf))).x / size
        square = float(np.sum((torque - columns @ x) ** 2))
        total = float(np.sum((torque - torque.mean()) ** 2))
        return cls(x, late, square, 1.0 - square / max(total, 1e-300))


def stated_loop(proportional: FloatArray, derivative: FloatArray) -> PositionLoop:
    """Return a PD loop with stated gains, shapes (n,)."""
    zero, never = np.zeros_like(proportional), np.full_like(proportional, np.inf)
    gains = np.array([proportional, derivative, zero])
    return PositionLoop(zero, gains, zero, zero, never, zero, origin="stated")


def identified_loop(model: IdentifiedModel, recording: Recording) -> PositionLoop:
    """Return the position loop that was identified with a model, at the gain of a recording.

    Args:
        model: The model, with position loops.
        recording: The recording, whose sidecar may state its `position_gain`.
    """
    entries = [model.position_loop[joint] for joint in model.robot.joints]
    stated = recording.sidecar.position_gain
    relative = np.array(
        [
            stated.get(joint, float(entry.position_gain)) / float(entry.position_gain)
            for joint, entry in zip(model.robot.joints, entries, strict=True)
        ]
    )
    zero = np.zeros(len(entries))
    gains = np.array([[e.proportional for e in entries], [e.derivative for e in entries], zero])
    limits = [np.inf if e.error_limit is None else float(e.error_limit) for e in entries]
    return PositionLoop(
        zero,
        gains * relative,
        zero,
        np.array([float(e.delay) for e in entries]),
        np.array(limits) / relative,
        zero,
        origin="model",
    )


def _integral(error: FloatArray, t: FloatArray) -> FloatArray:
    """Integral of the position error from the start. Shape (N, n) [rad s]."""
    return np.asarray(np.cumsum(error, axis=0) * float(np.median(np.diff(t))))


def torque_limits(model: SimulatorModel) -> FloatArray:
    """Return the torque limits of a robot, infinite without. Shape (n,) [N m or N]."""
    limits = [model.torque_limit(j) for j in range(len(model.joints))]
    return np.array([np.inf if limit is None else limit for limit in limits])


class Replay:
    """MuJoCo with an exported robot, driven by the commands of a recording.

    Args:
        model: The robot.
        data: The recording.
        loop: The position loop; None: the command is the torque.
        with_friction: Whether the friction module adds what MJCF does not hold.
    """

    def __init__(
        self,
        model: SimulatorModel,
        data: ReplayInput,
        loop: PositionLoop | None,
        with_friction: bool = False,
    ) -> None:
        import mujoco

        self._mujoco, self._data, self._loop = mujoco, data, loop
        self._robot = model.model.robot
        compiled = mujoco.MjModel.from_xml_string(mjcf_file.mjcf_text(model, servos=False))
        compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._model, self._state = compiled, mujoco.MjData(compiled)
        joints = [compiled.joint(name) for name in self._robot.joints]
        self._position = np.array([int(joint.qposadr[0]) for joint in joints])
        self._degree = np.array([int(joint.dofadr[0]) for joint in joints])
        self._limit = torque_limits(model)
        self._friction = friction_runtime.Friction(friction_table(model)) if with_friction else None

    def run(self, start: int, end: int) -> ReplayRun:
        """Simulate from the recorded state of a row to another row.

        Args:
            start: First row.
            end: Row after the last one.
        """
        if self._friction is None:
            return self._simulated(start, end)
        self._friction.reset()
        friction_runtime.install(self._mujoco, self._model, self._friction)
        try:
            return self._simulated(start, end)
        finally:
            self._mujoco.set_mjcb_passive(None)

    def _simulated(self, start: int, end: int) -> ReplayRun:
        """The simulation of `run`."""
        mujoco, model, state, data = self._mujoco, self._model, self._state, self._data
        mujoco.mj_resetData(model, state)
        names = [model.joint(str(name)) for name in list(self._robot.model.names)[1:]]
        q, v = data.motion.q[start], data.motion.dq[start]
        for joint, value, speed in zip(
            names, self._robot.expand(q), self._robot.spread @ v, strict=True
        ):
            state.qpos[int(joint.qposadr[0])] = value
            state.qvel[int(joint.dofadr[0])] = speed
        rows, step = end - start, float(model.opt.timestep)
        times = data.t[start:end] - data.t[start]
        count = int(np.ceil(times[-1] / step)) + 1
        grid: FloatArray = step * np.arange(count, dtype=float)
        command = self._command(start, end, grid)
        follows = _following_share(self._loop, step, len(q))
        positions, torques = np.empty((count, len(q))), np.empty((count, len(q)))
        for k in range(count):
            positions[k] = state.qpos[self._position]
            # semi-implicit Euler: qvel is the velocity half a step before that of qpos
            speed = state.qvel[self._degree] + 0.5 * step * state.qacc[self._degree]
            torque = command(k, positions[k], speed)
            torque = np.clip(torque, -self._limit, self._limit)
            torques[k] = torque if k == 0 else torques[k - 1] + follows * (torque - torques[k - 1])
            if not np.abs(positions[k]).max() < 1e3:
                positions[k:], torques[k:] = np.inf, np.nan
                break
            state.ctrl[:] = torques[k]
            mujoco.mj_step(model, state)
        index = np.minimum(np.rint(times / step).astype(int), count - 1)
        assert len(index) == rows
        return ReplayRun(positions[index], torques[index])

    def _command(
        self, start: int, end: int, grid: FloatArray
    ) -> Callable[[int, FloatArray, FloatArray], FloatArray]:
        """Torque of the motors by step, position and velocity."""
        data, loop = self._data, self._loop
        times = data.t[start:end] - data.t[start]

        def at_steps(values: FloatArray) -> FloatArray:
            return np.column_stack([np.interp(grid, times, x) for x in values[start:end].T])

        if loop is None or data.reference is None:
            assert data.torque is not None  # checked by replay_input
            recorded = at_steps(data.torque)
            return lambda k, q, v: recorded[k]
        late = grid[:, None] + times[0] - loop.delay

        def delayed(values: FloatArray) -> FloatArray:
            now = data.t - data.t[start]
            return np.column_stack([np.interp(late[:, j], now, x) for j, x in enumerate(values.T)])

        q_ref, v_ref = delayed(data.reference.q), delayed(data.reference.dq)
        feedforward = loop.forward * at_steps(data.rigid) + loop.constant
        proportional, derivative, integral_gain = loop.gains
        step = grid[1] - grid[0]
        error = data.reference.q - data.motion.q
        if data.torque is not None:
            error = error * (np.abs(data.torque) < SATURATION_SHARE * self._limit)
        integral, limit = _integral(error, data.t)[start].copy(), self._limit

        def command(k: int, q: FloatArray, v: FloatArray) -> FloatArray:
            e = q_ref[k] - q
            pulled = np.clip(e, -loop.error_limit, loop.error_limit)
            torque = feedforward[k] + proportional * pulled + derivative * (v_ref[k] - v)
            torque = torque + integral_gain * integral
            integral[:] += step * e * (np.abs(torque) < limit)
            return np.asarray(torque)

        return command


def _following_share(loop: PositionLoop | None, step: float, n: int) -> FloatArray:
    """Share of the way to its command that the motor's torque goes in a time step. Shape (n,).

    A torque that is held for a step is late by half of it.
    """
    lag = np.zeros(n) if loop is None else loop.lag
    return np.asarray(1.0 / np.maximum(lag / step + 0.5, 1.0))


@dataclass(frozen=True)
class ReplayErrors:
    """Errors of a replayed robot.

    Attributes:
        name: Which robot: "before", "after", …
        free: The simulation of the complete stretch.
        position: RMS position error of the free run. Shape (n,) [rad or m].
        torque: RMS torque error of the free run, of a position loop; NaN for replayed torque or
            where no torque was recorded. Shape (n,) [N m].
        lost: Time at which the free run is lost [s]; None: it is not.
        horizons: RMS position error over windows of each length of `HORIZONS` that fits. Shape
            (horizons, n) [rad or m].
    """

    name: str
    free: ReplayRun
    position: FloatArray
    torque: FloatArray
    lost: float | None
    horizons: FloatArray


def fitting_horizons(data: ReplayInput) -> list[float]:
    """Return the lengths of windows that fit into a recording [s]."""
    return [horizon for horizon in HORIZONS if horizon < 0.5 * data.t[-1]]


def replay_errors(name: str, replay: Replay, data: ReplayInput) -> ReplayErrors:
    """Simulate the complete stretch and short windows of it.

    Args:
        name: Which robot.
        replay: The simulation.
        data: The recording.
    """
    free = replay.run(0, len(data.t))
    deviation = np.clip(np.nan_to_num(free.q, posinf=1e9) - data.q, -LOST_DISTANCE, LOST_DISTANCE)
    is_lost = np.abs(deviation).max(axis=1) >= LOST_DISTANCE
    lost = float(data.t[int(np.argmax(is_lost))]) if is_lost.any() else None
    torque = np.full(data.motion.q.shape[1], np.nan)
    if data.torque is not None and data.reference is not None:
        torque = np.sqrt(np.mean((free.torque - data.torque) ** 2, axis=0))
    rows = [_window_error(replay, data, horizon) for horizon in fitting_horizons(data)]
    return ReplayErrors(
        name,
        free,
        np.sqrt(np.mean(deviation**2, axis=0)),
        torque,
        lost,
        np.array(rows).reshape(-1, data.motion.q.shape[1]),
    )


def _window_error(replay: Replay, data: ReplayInput, horizon: float) -> FloatArray:
    """RMS position error over windows of a length. Shape (n,)."""
    size = max(2, round(horizon / float(np.median(np.diff(data.t)))))
    starts = np.arange(0, len(data.t) - size, size)
    chosen = starts[
        np.unique(np.linspace(0, len(starts) - 1, min(MAX_WINDOWS, len(starts))).astype(int))
    ]
    square = np.zeros(data.motion.q.shape[1])
    for start in chosen:
        run = replay.run(int(start), int(start) + size)
        deviation = np.nan_to_num(run.q, posinf=1e9) - data.q[start : start + size]
        square += np.mean(np.clip(deviation, -LOST_DISTANCE, LOST_DISTANCE) ** 2, axis=0)
    return np.asarray(np.sqrt(square / len(chosen)))

"""Position error in a replay by a model that has the true form of every hidden effect.

All parameters of the bodies, the actuators and the effects of a simulated robot are unknown and
estimated from a recording with white torque noise. Their covariance is the Cramér-Rao bound. Its
torque error along another motion passes the compliance of the position loop, joint by joint:

    δq_j = −δτ_j / (M_jj s² + F_v s + (K_p + K_d s + K_i/s)/(1 + T s))

Nobody who fits a model to the recording can expect less without knowing some of the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excite._types import FloatArray
from excite.exporters.mujoco_replay import PositionLoop
from excite.identification.identified_model import IdentifiedModel
from excite.robot.dynamics import regressor
from excite.robot.samples import Samples
from excite.simulator.effect_instance import EffectInstance
from excite.simulator.mujoco_dynamics import RigidBodyDynamics, build_dynamics
from excite.simulator.physical_effect import JointStates, PhysicalEffect
from excite.simulator.simulated_robot import SimulatedRobot

PARAMETER_STEP = 1e-3
"""Relative step of a derivative by a parameter of an effect; of a phase, the step [rad]."""
RANK_TOLERANCE = 1e-9
"""Smallest eigenvalue of the scaled information that counts: standard parameters are dependent."""
POSES = 250
"""Poses over which the inertia of the joints is averaged."""


@dataclass(frozen=True)
class KnownForms:
    """A robot and its hidden effects.

    Attributes:
        robot: The robot without effects.
        effects: Its hidden effects.
        model: An identified model of it, of which only the layout of the parameters is used.
        noise: Standard deviation of the recorded torque, shape (n,) [N m].
        rate: Rate of the recordings [Hz].
    """

    robot: SimulatedRobot
    effects: Sequence[EffectInstance]
    model: IdentifiedModel
    noise: FloatArray
    rate: float

    def position_error(
        self, learnt: Samples, unseen: Samples, loop: PositionLoop
    ) -> tuple[float, float]:
        """Return the RMS position error along one motion after learning from another.

        Args:
            learnt: The motion that is learnt, every row of the recording.
            unseen: The motion that is replayed.
            loop: The position loop.

        Returns:
            With the effects, and of the robot without effects and without knowing of any [rad].
        """
        train, test = (self._sensitivity(motion) for motion in (learnt, unseen))
        inertia = self._mean_inertia(unseen.q)
        base = self._base_count()
        with_effects, without = (
            self._error(train[:, :, :count], test[:, :, :count], loop, inertia)
            for count in (train.shape[2], base)
        )
        return with_effects, without

    def _error(
        self, train: FloatArray, test: FloatArray, loop: PositionLoop, inertia: FloatArray
    ) -> float:
        """RMS position error, from the sensitivities of the torque along both motions."""
        x = (train / self.noise[:, None]).reshape(-1, train.shape[2])
        information = x.T @ x
        size = np.sqrt(np.diag(information))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
        kept = values > RANK_TOLERANCE * values.max()
        root = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
        square = 0.0
        for j, joint in enumerate(np.moveaxis(test, 1, 0)):
            torque = joint @ root
            # mirrored in time: it begins where it ends
            spectrum = np.fft.rfft(np.concatenate([torque, torque[::-1]]), axis=0)
            s = 2j * np.pi * np.fft.rfftfreq(2 * len(torque), 1.0 / self.rate)[1:]
            p, d, i = loop.gains[:, j].tolist()
            stiffness = inertia[j] * s**2 + self.robot.actuators.viscous[j] * s
            stiffness += (p + d * s + i / s) / (1.0 + loop.lag[j] * s)
            lines = np.abs(spectrum[1:] / stiffness[:, None]) ** 2
            square += 2.0 * float(lines.sum()) / (2.0 * len(torque)) ** 2
        return float(np.sqrt(square / test.shape[1]))

    def _base_count(self) -> int:
        """Number of parameters without those of the effects."""
        return self.model.layout.count + len(self.robot.joints)

    def _sensitivity(self, motion: Samples) -> FloatArray:
        """Derivatives of the torque by all parameters, shape (N, n, K), the effects' last."""
        actuators, layout = self.robot.actuators, self.model.layout
        columns = regressor(self.model.robot, layout, motion)
        sign = np.tanh(motion.dq / actuators.width)
        width = -actuators.coulomb * (1.0 - sign**2) * motion.dq / actuators.width
        diagonal = np.eye(motion.q.shape[1])
        columns[:, :, layout.block("coulomb")] = sign[:, :, None] * diagonal
        load = self._dynamics().inverse_dynamics(motion.q, motion.dq, motion.ddq)
        times = np.arange(len(motion)) / self.rate
        x = JointStates(times, motion.q, motion.dq, motion.ddq, load)
        parts = [columns, width[:, :, None] * diagonal]
        parts += [self._effect_columns(effect, x) for effect in self.effects]
        return np.concatenate(parts, axis=2)

    def _effect_columns(self, effect: EffectInstance, x: JointStates) -> FloatArray:
        """Derivatives of the torque by the parameters of an effect, in units of their values."""
        columns = []
        for name, value in effect.values.items():
            step = PARAMETER_STEP if name == "phase" else PARAMETER_STEP * value
            more, less = (
                self._torque(replace(effect, values={**effect.values, name: value + change}), x)
                for change in (step, -step)
            )
            columns.append((more - less) / (2.0 * PARAMETER_STEP))
        return np.stack(columns, axis=2)

    def _torque(self, instance: EffectInstance, x: JointStates) -> FloatArray:
        """Torque of an effect along a motion, shape (N, n) [N m]."""
        effect = instance.physics(self.robot)
        assert effect is not None
        if type(effect).torque is PhysicalEffect.torque:
            return np.zeros_like(x.q)  # it changes the recorded torque, not that of the robot
        states = np.zeros((len(x.t), effect.state_size))
        if effect.state_size:
            speed = np.diff(x.q, axis=0) * self.rate
            for k in range(1, len(states)):
                now = JointStates(x.t[k], x.q[k], speed[k - 1], x.a[k], x.load[k])
                states[k] = effect.advance_state(now, states[k - 1], 1.0 / self.rate)
        torque = effect.torque(x, states)
        assert torque is not None
        return torque

    def _mean_inertia(self, q: FloatArray) -> FloatArray:
        """Mean inertia of links and rotors at each joint, shape (n,) [kg m²]."""
        dynamics = self._dynamics()
        poses = q[:: max(1, len(q) // POSES)]
        matrices = [dynamics.mass_and_bias(pose, np.zeros_like(pose))[0] for pose in poses]
        return np.mean([np.diag(m) for m in matrices], axis=0) + self.robot.actuators.inertia

    def _dynamics(self) -> RigidBodyDynamics:
        """Rigid bodies of the robot."""
        robot = self.robot
        return build_dynamics(robot.tree, robot.joints, robot.lock, robot.gravity)

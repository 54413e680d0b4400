"""Instruments for IDIM-IV: regressors along a motion that has no noise of the encoders in it (Janot, Vandanjon & Gautier 2014).

Z is Γ along the motion of the auxiliary model, which is the identified robot under the identified controller, tracking q_ref; or along
q_ref itself. Both know of the recording's noise only through a few parameters. The auxiliary motion is taken where it lies closer
to the recorded one than q_ref does, by the geometric mean over the joints of the RMS distances below the band.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import UnusableInput
from ..recordings import Recording
from . import control, equations, mechanism, signals
from .band import Band, Grid
from .control import Law
from .equations import Model
from .signals import Piece

Array = np.ndarray


class Kind(enum.Enum):
    """Along which motion instruments are computed."""

    AUXILIARY = "auxiliary model"
    REFERENCE = "reference motion"


@dataclass(frozen=True)
class Instruments:
    """rows: Z, row by row with the equations. Shape (N, n, p). pieces: the motion they are of, with the recorded torque.

    law: of the controller. strayed: RMS distance of the auxiliary motion from the recorded one, inf where it was lost; behind: that of
    the reference. Shapes (n,) [rad or m], below the band. asked: the kind was, and not chosen by the rule.
    """

    rows: Array
    pieces: tuple[Piece, ...]
    kind: Kind
    law: Law
    strayed: Array
    behind: Array
    asked: bool = False

    @property
    def words(self) -> str:
        """Which motion, and why."""
        if self.asked:
            why = "as asked"
        elif not np.isfinite(self.strayed).all():
            why = "the model loses it under the controller that the recording suggests"
        else:
            why = f"the auxiliary motion strays by {_ratio(self.strayed, self.behind):.2g} of the reference's distance from the recorded one"
        return f"instruments along the {self.kind.value}: {why}"


def build(
    model: Model, recordings: Sequence[Recording], hertz: float, psi: Array, kind: Kind | None = None, *, average: bool = True
) -> Instruments:
    """Z with the filter, the grid and the mean periods of `equations.build(model, signals.pieces(recordings, average=average), hertz)`.

    psi: a first, physically consistent estimate, such as one by least squares. Shape (P,). kind: which motion; None: by the rule above.
    Raises UnusableInput, naming file and joint, where there is no q_ref, and where the auxiliary model was asked for and is lost.
    """
    for recording in recordings:
        _require_reference(recording)
    measured = list(signals.pieces(recordings, average=average))
    told = list(signals.pieces([dataclasses.replace(r, q=r.qref) for r in recordings if r.qref is not None], average=average))
    body = mechanism.of(model, psi)
    commands = [control.commanded(body, piece, hertz) for piece in told]
    law = control.identified(commands, measured, hertz)
    behind = _distance(measured, told, hertz)
    moved = [] if kind is Kind.REFERENCE else _auxiliary(body, law, commands, told)
    strayed = _distance(measured, moved, hertz) if moved else np.full(model.robot.n, np.inf)
    if kind is Kind.AUXILIARY and not moved:
        raise UnusableInput(f"{recordings[0].source}: the model loses qref under the controller found; take the reference motion as instrument")
    chosen = kind or (Kind.AUXILIARY if moved and _ratio(strayed, behind) < 1.0 else Kind.REFERENCE)
    pieces = moved if chosen is Kind.AUXILIARY else told
    return Instruments(equations.build(model, pieces, hertz).regressor, tuple(pieces), chosen, law, strayed, behind, kind is not None)


def _require_reference(recording: Recording) -> None:
    for i, joint in enumerate(recording.joints):
        if recording.qref is None or not np.isfinite(recording.qref[:, i]).all():
            lack = "has rows without" if recording.has("qref", joint) else "has no"
            raise UnusableInput(
                f"{recording.source}: joint '{joint}' {lack} commanded position, which instruments come from; record qref.{joint}, "
                "or take another estimator"
            )


def _auxiliary(body: mechanism.Mechanism, law: Law, commands: Sequence[control.Command], told: Sequence[Piece]) -> list[Piece]:
    """The pieces as the model under the law moves; none where it is lost in any."""
    out = []
    for k, (command, piece) in enumerate(zip(commands, told, strict=True)):
        q = control.followed(body, law, command, k)
        if q is None:
            return []
        out.append(dataclasses.replace(piece, q=q))
    return out


def _distance(measured: Sequence[Piece], others: Sequence[Piece], hertz: float) -> Array:
    """RMS of the difference of positions below the band. Shape (n,)."""
    parts = []
    for piece, other in zip(measured, others, strict=True):
        band = Band(hertz, piece.rate, len(piece), piece.periodic)
        parts.append(band.low(piece.q - other.q, Grid.KEPT))
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))


def _ratio(strayed: Array, behind: Array) -> float:
    """Geometric mean of the joints' ratios; a joint that follows its reference exactly counts as it is."""
    tiny = 1e-12
    return float(np.exp(np.mean(np.log((strayed + tiny) / (behind + tiny)))))

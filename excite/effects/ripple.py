"""Torque that waves over a joint's angle: teeth that mesh, a motor's poles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from .._linear_algebra import factors
from .effect import MULTIPLES, CandidateModel, Effect, NonlinearParameter, alone, multiples, waves
from .recorded_motion import RecordedMotion
from .transmission import LEAST_TURN

Array = np.ndarray
NEARBY, FAINT = 0.02, 0.3
"""How near two orders are the same; and over its strongest multiple, below which a wave is hardly there."""
ORDERS, WITHIN, CELLS = 12, 2.5, 20_000_000
"""Orders of a ripple that are tried, at the most, either way; how far one may be off, times what a joint turns; and orders times rows that
are looked at at once."""
OWN, FEWEST, QUIETEST = 0.01, 0.05, 1e-3
"""Share of a wave that the base must leave; share of rows that must lie below the band; and over the loudest joint, as what a joint counts
at the least of which the base leaves nothing."""
ROUND = 1.5
"""Waves in the longest stretch, from which a torque comes round."""


def _waved(t: RecordedMotion, s: CandidateModel) -> Array:
    """Waves of an order, and of those of its multiples that are stated."""
    return alone(t, s.joint_index, waves(s.values, t.samples.q[:, s.joint_index]))


def _ripple(tracks: Sequence[RecordedMotion]) -> Iterator[CandidateModel]:
    def rippled(j: int, more: Mapping[str, float]) -> Callable[[float], CandidateModel]:
        def shape(order: float) -> CandidateModel:
            fixed = {"order": order, **more}
            return CandidateModel(
                "torque_ripple",
                j,
                _waved,
                fixed,
                parameters=lambda c: _strongest(fixed, c),
                allows_several=True,
            )

        return shape

    for j in range(tracks[0].n):
        turn, taken = max(float(np.ptp(t.samples.q[:, j])) for t in tracks), list[float]()
        for order in _orders(
            tracks, j
        ):  # what one has with its multiples, none after it has with its own
            near = 1.0 + WITHIN / (turn * order)
            free = [
                k
                for k in MULTIPLES
                if all(abs(k * order - other) > NEARBY * other for other in taken)
            ]
            yield NonlinearParameter(order, order / near, order * near, rippled(j, {})).at(order)
            if free and all(abs(order - other) > NEARBY * other for other in taken):
                yield NonlinearParameter(
                    order, order / near, order * near, rippled(j, {MULTIPLES[k]: 1.0 for k in free})
                ).at(order)
                taken += [order, *(k * order for k in free)]


def _strongest(values: Mapping[str, float], c: Array) -> dict[str, float]:
    """The order's wave; or its strongest multiple, of an order that is hardly there: nobody would tell that by a half or a third of it."""
    sizes = np.hypot(c[::2], c[1::2])
    told = int(np.argmax(sizes)) if sizes[0] < FAINT * sizes.max() else 0
    return {"amplitude": float(sizes[told]), "order": values["order"] * multiples(values)[told]}


def _orders(tracks: Sequence[RecordedMotion], joint: int) -> list[float]:
    """Orders at which what the base fit leaves has power, beside all that the base could say, then as it is: where a prior is
    trusted, the base says nothing. On a fine grid up to 300 a turn.

    What has not come round half as often again in the longest stretch is a spring as well.
    """
    track = max(tracks, key=len)
    q = np.interp(track.time, track.times, track.samples.q[:, joint])
    turn = float(np.ptp(q))
    if turn < LEAST_TURN:
        return []
    speed = np.interp(track.time, track.times, track.samples.dq[:, joint])
    step = 2.0 * np.pi / turn / 3.0
    grid = np.arange(max(3.0, ROUND * 2.0 * np.pi / turn), 300.0, max(step, 0.05))
    some = slice(None) if len(grid) * len(q) <= CELLS else _scattered(len(q), CELLS // len(grid))
    q, speed = q[some], speed[some]
    fastest = 2.0 * np.pi * track.band.hertz

    def turning(which: Array) -> Array:
        return np.exp(1j * np.outer(which, q)) * (
            np.abs(np.outer(which, speed)) < fastest
        )  # the rest is above the band

    every, out = turning(grid), list[float]()
    for left, base in (
        _freed(track.residual[some], track.gamma[some], joint),
        (track.residual[some, joint], np.zeros((len(q), 0))),
    ):
        found = _peaks(turning, (grid, every, step), left, base)
        out += [
            order for order in found if all(abs(order - other) > NEARBY * other for other in out)
        ]
    return out


def _scattered(rows: int, count: int) -> Array:
    """Some of many rows: not every so many, which would be a rate of its own."""
    return np.sort(np.random.default_rng(0).permutation(rows)[:count])


def _freed(left: Array, gamma: Array, joint: int) -> tuple[Array, Array]:
    """What is left of a joint's torque beside all that the base model could say of all joints', and that joint's rows of columns that span
    this, orthonormal over all joints, each over what is left of it. Shapes (N, n), (N, n, p) -> (N,), (N, r)."""
    rms = np.sqrt(np.mean(left**2, axis=0))
    rms = np.maximum(rms, max(QUIETEST * float(rms.max()), 1e-300))
    span = factors((gamma / rms[:, None]).reshape(left.size, -1))[0]
    y = (left / rms).ravel()
    free = (y - span @ (span.T @ y)).reshape(left.shape)
    return np.asarray(free[:, joint] * rms[joint]), np.asarray(
        span.reshape(*left.shape, -1)[:, joint]
    )


def _peaks(
    turning: Callable[[Array], Array], about: tuple[Array, Array, float], left: Array, base: Array
) -> list[float]:
    """Orders of waves that fit best beside a base (Lomb 1976, over angle; Zechmeister & Kürster 2009), each in what those before it leave,
    lest a strong one's neighbours hide a slight one (Högbom 1974).

    turning: waves of orders, cosine and sine as one. about: orders, their waves and the least apart that two are. left: free of the base.
    base: one joint's rows of columns that are orthonormal over all joints. Shapes (N,), (N, r).
    """
    grid, every, step = about

    def ready(of: Array) -> tuple[Array, Array]:
        """Waves, and the inverse of their products beside the base; zero where the base says them, or the band leaves few rows."""
        said, parts = of @ base, np.stack([of.real, of.imag])
        squares, own = np.einsum("akr,bkr->kab", parts, parts), np.stack([said.real, said.imag])
        free = squares - np.einsum("akp,bkp->kab", own, own)
        there = np.linalg.eigvalsh(free)[:, 0] > OWN * np.trace(squares, axis1=1, axis2=2)
        there &= np.count_nonzero(of, axis=1) >= FEWEST * of.shape[1]
        out = np.zeros_like(free)
        out[there] = np.linalg.inv(free[there])
        return of, out

    def fit(of: Array, inverse: Array) -> tuple[Array, Array]:
        """Power of each, and coefficients. Shapes (k,), (k, 2)."""
        scores = np.stack([of.real @ left, of.imag @ left], axis=1)
        told = np.einsum("kab,kb->ka", inverse, scores)
        return np.sum(told * scores, axis=1), told

    out, tried = list[float](), ready(every)
    while len(out) < ORDERS:
        found = fit(*tried)[0]
        for other in out:
            found[np.abs(grid - other) <= 1.5 * step] = 0.0
        if not found.any():
            break
        near = grid[int(np.argmax(found))] + step * np.linspace(-1.0, 1.0, 41)
        close = turning(near)
        power, told = fit(*ready(close))
        best = int(np.argmax(power))
        out.append(float(near[best]))
        torque = np.column_stack([close[best].real, close[best].imag]) @ told[best]
        left = left - torque + base @ (base.T @ torque)
    return out


EFFECTS = (
    Effect(
        "torque_ripple",
        "A cos kq + B sin kq",
        _waved,
        _ripple,
        {"order": "1/turn", "amplitude": "N m"},
        "periodic in the angle, whatever the speed",
        ("encoder_error",),
        "slow constant speed over a turn",
        form={"order": 0.02, "amplitude": 0.1},
        residual_log_offset=-0.5,
    ),
)

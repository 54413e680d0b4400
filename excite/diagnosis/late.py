"""Delayed effects: with a recording delay, all torque of a joint is delayed, not only the base
model.

τ(t) = [Y ψ + Σ effects](t − d), or all of it through a first-order lag. If only the base model were
delayed, flexible effects would fit the delay of the others. Once a delay is found, everything at
its joint is therefore sought again, delayed by what predicts best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from ..effects.effect import CandidateModel, RecordingDelay
from . import judge, search
from .contest import CLEARLY
from .judge import Verdict
from .search import EffectRegression, Trial

LEAST, SETTLED, PASSES = 5e-4, 0.05, 2
"""Of a delay, from which it is one [s]; how far off it was, over itself, to be looked at again; and
how often that is."""
FURTHEST, TRIED = 3.0, 5
"""How many times as long, or as short, a delay may be as it was told at first; and how many between
are tried."""
USUAL = 0.01
"""Of a delay that is not known at all [s]."""
Delays = dict[int | None, RecordingDelay]


def followed(
    one: EffectRegression, verdict: Verdict, again: bool = False
) -> tuple[EffectRegression, Verdict]:
    """Delay everything that a found delay affects, where that predicts better.

    Args:
        one: The effect regression.
        verdict: The verdict.
        again: Whether delays were sought before, with nearly the same base model.
    """
    if verdict.together is None:
        return one, verdict
    together, loud = verdict.together, _above_noise(one, verdict.together)
    told, tuned = (
        _worth(_delays(one, together) or ({} if again else _hidden(one, together)), loud),
        list[CandidateModel](),
    )
    if told:
        told, tuned = _timed(one, together, told, again)
    for _ in range(PASSES):
        if not told:
            break
        later, found = judge.judged(*_later(one, together, told, loud, tuned))
        if found.together is None or found.together.gain <= together.gain:
            break
        now = _delays(later, found.together)
        if not set(told) <= set(now):
            break
        one, verdict, together, loud, tuned = (
            later,
            found,
            found.together,
            _above_noise(later, found.together),
            [],
        )
        off = {
            j: abs(now[j].seconds - d.seconds) > SETTLED * d.seconds or now[j].lagging != d.lagging
            for j, d in told.items()
        }
        told = _worth({joint: now[joint] for joint, still in off.items() if still}, loud)
    return one, verdict


def renewed(
    one: EffectRegression, together: Trial, shapes: Iterable[CandidateModel]
) -> list[CandidateModel]:
    """Return candidate models delayed like those that were fitted."""
    late = [values for i in together.shapes if "late" in (values := one.shapes[i].values)]
    told = {
        int(v["late_joint"]) if "late_joint" in v else None: RecordingDelay(
            v["late"], "lagging" in v
        )
        for v in late
    }
    return _like(shapes, told)


def _delays(one: EffectRegression, together: Trial) -> Delays:
    """Delays that were found together with something that they delay."""
    chosen = [one.shapes[i] for i in together.shapes]
    fitted = zip(chosen, one.split(together.shapes, together.coefficients), strict=True)
    found = {
        s.joint: RecordingDelay(s.values.get("seconds", float(c[0])), "lagging" in s.values)
        for s, c in fitted
        if s.effect == "delay"
    }
    return {
        joint: d
        for joint, d in found.items()
        if d.seconds > LEAST and any(_follows(shape, joint) for shape in chosen)
    }


def _hidden(one: EffectRegression, together: Trial) -> Delays:
    """Delays that may be hidden behind presliding hysteresis, which can fit them."""
    bent = {one.shapes[i].joint for i in together.shapes if one.shapes[i].effect == "hysteresis"}
    return dict.fromkeys(
        bent & {shape.joint for shape in one.listed if shape.effect == "delay"},
        RecordingDelay(USUAL),
    )


def _above_noise(one: EffectRegression, together: Trial) -> set[int]:
    """Joints whose residual exceeds the noise."""
    left, noise = search.level(one, together.shapes), one.measured.noise
    return {
        int(j)
        for j in np.flatnonzero(left > 0.0 if noise is None else left > (1.0 + CLEARLY) * noise)
    }


def _worth(told: Delays, loud: set[int]) -> Delays:
    """Delays of joints with a residual."""
    return {joint: d for joint, d in told.items() if joint in loud or (joint is None and loud)}


def _follows(shape: CandidateModel, joint: int | None) -> bool:
    """Tell whether a model's torque is delayed with a joint's torque, or with all torque."""
    return (
        shape.effect != "delay"
        and not shape.values.get("measured")
        and (joint is None or shape.joint == joint)
    )


def _moved(shape: CandidateModel, told: Delays) -> CandidateModel | None:
    """A model with its delay; None for a delay that is now applied exactly."""
    if shape.effect == "delay" and shape.joint in told and "seconds" not in shape.values:
        return None
    for joint, delay in told.items():
        if _follows(shape, joint):
            return shape.delayed(delay, joint)
    return shape


def _like(shapes: Iterable[CandidateModel], told: Delays) -> list[CandidateModel]:
    """All models with their delays."""
    return [moved for shape in shapes if (moved := _moved(shape, told)) is not None]


def _timed(
    one: EffectRegression, together: Trial, told: Delays, nearly: bool
) -> tuple[Delays, list[CandidateModel]]:
    """Optimise each delay jointly with what was found, as a dead time and as a lag.

    Returns the delays, and the models optimised with them.
    """
    from scipy.optimize import minimize_scalar  # slow to import

    bare, out, chosen = search.only(one, ()), dict(told), [one.shapes[i] for i in together.shapes]

    def fitted(delays: Delays, sweeps: int) -> tuple[EffectRegression, Trial]:
        others = [shape for shape in chosen if shape.effect != "delay" or shape.joint not in delays]
        fixed = [
            dataclasses.replace(_by(one.listed, joint, d), nonlinear=None)
            for joint, d in delays.items()
        ]
        design = search.appended(bare, [*_like(others, delays), *fixed])
        finer, turned = search.refined(design, range(len(design.shapes)), sweeps)
        return finer, search.trial(finer, turned)

    for joint, d in told.items():
        tries = np.linspace(-1.0, 1.0, TRIED)
        ways = [
            RecordingDelay(float(d.seconds * FURTHEST**x), lagging)
            for x in (tries[1:-1] if nearly else tries)
            for lagging in (False, True)
        ]
        tried = [(*fitted({**out, joint: way}, 1), way) for way in ways]
        finer, best, about = max(tried, key=lambda own: own[1].gain)
        chosen = [finer.shapes[i] for i in best.shapes]
        step, middle = 2.0 / (TRIED - 1) * np.log(FURTHEST), np.log(about.seconds)

        def cost(x: float, joint: int | None = joint, about: RecordingDelay = about) -> float:
            return -fitted({**out, joint: about._replace(seconds=float(np.exp(x)))}, 0)[1].gain

        best_x = minimize_scalar(cost, bounds=(middle - step, middle + step), method="bounded").x
        out[joint] = about._replace(seconds=float(np.exp(best_x)))
    return out, _like(
        (shape for shape in chosen if shape.effect != "delay" or shape.joint not in out), out
    )


def _later(
    one: EffectRegression,
    together: Trial,
    told: Delays,
    loud: set[int],
    tuned: list[CandidateModel],
) -> tuple[EffectRegression, list[int]]:
    """The regression with delayed models, and the models to start with."""
    where = {
        *loud,
        *(one.shapes[i].joint for i in together.shapes if one.shapes[i].effect != "delay"),
    }

    def moved(shape: CandidateModel) -> CandidateModel | None:
        return _moved(shape, told) if shape.effect == "delay" or shape.joint in where else shape

    listed = [late for shape in one.listed if (late := moved(shape)) is not None]
    now = [moved(shape) for shape in one.shapes]
    kept = [k for k, shape in enumerate(one.shapes) if now[k] is shape]
    first = [*(_by(listed, joint, delay) for joint, delay in told.items()), *tuned]
    behind = [own for own in now if own is not None and "late" in own.values]
    wider = search.relaid(one, kept, behind, first, listed)
    there = [
        kept.index(i)
        for i in together.shapes
        if i in kept and one.shapes[i].effect != "delay" and not tuned
    ]
    return wider, [*range(len(wider.shapes) - len(first), len(wider.shapes)), *there]


def _by(
    listed: Iterable[CandidateModel], joint: int | None, delay: RecordingDelay
) -> CandidateModel:
    """Candidate model of a delay of a joint, or of all joints, by a given time."""
    alike = (
        s
        for s in listed
        if s.effect == "delay" and s.joint == joint and ("lagging" in s.values) == delay.lagging
    )
    knob = next(shape.nonlinear for shape in alike if shape.nonlinear is not None)
    return dataclasses.replace(knob, low=0.5 * delay.seconds, high=2.0 * delay.seconds).at(
        delay.seconds
    )

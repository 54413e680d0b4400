"""Negative numbers that were stored as unsigned integers: −6 as 65530.

Servos state positions, velocities and currents as integers of 16 or 32 bits in two's complement. A
logger that takes them for unsigned ones adds 2¹⁶ or 2³² to each negative number.
"""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..robot.robot import Robot
from .block import QUANTITIES, Block
from .column_names import column_of
from .missing_values import SLOW

BITS = (16, 32)
"""Numbers of bits of the integers that servos state."""
POSITIONS = ("q", "qref", "qlink")
"""Quantities that may be wrapped to [0, 2π), which looks alike in units of a fraction of a turn:
only whole numbers are compared."""
STEP_TOLERANCE = 1e-3
"""Distance of a value from a multiple of the unit, over the unit, that counts as rounding [1]."""
MIN_DISTINCT = 2
"""Smallest number of distinct values on either side: a single one may be a code for an error, as
65535 is."""


def check_signs(source: str, block: Block, robot: Robot) -> None:
    """Check that no quantity holds negative numbers as unsigned integers.

    Such values are multiples of one unit between 0 and 2ᵇ units, and lie at both ends of that range
    without any in the middle: the gap between them is wider than both groups together. With the
    right signs, the two groups adjoin at zero: their distance is shorter than the wider of them.

    Args:
        source: Name of the recording, for messages.
        block: All rows, as they were read.
        robot: The robot.

    Raises:
        UnusableInput: A quantity does; the message states the remedy.
    """
    for name, values in block.values.items():
        if name not in QUANTITIES or name in SLOW:
            continue
        for i in range(values.shape[1]):
            span = unsigned_range(values[:, i], whole=name in POSITIONS)
            if span is None:
                continue
            modulus, largest_positive = span
            raise UnusableInput(
                f"{source}: column {column_of(name, i, robot.joints)}: values near {modulus:.10g} "
                f"(up to {np.nanmax(values[:, i]):.10g}) are negative numbers stored unsigned; "
                f"subtract {modulus:.10g} from values above {largest_positive:.10g}, then convert "
                "them to SI units"
            )


def unsigned_range(values: FloatArray, *, whole: bool = False) -> tuple[float, float] | None:
    """Return what is to be subtracted from negative numbers stored unsigned, and from which values.

    Args:
        values: A signal, NaN where a value is missing. Shape (N,).
        whole: True if only whole numbers count, else multiples of any unit.

    Returns:
        2ᵇ units, and the largest positive number, 2ᵇ⁻¹ − 1 units; None if all signs are right.
    """
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < 2 * MIN_DISTINCT or distinct[0] < 0.0:
        return None
    # negative numbers and positive ones are on the two sides of the widest gap
    steps = np.diff(distinct)
    k = int(np.argmax(steps)) + 1
    if min(k, len(distinct) - k) < MIN_DISTINCT:
        return None
    unit = 1.0 if (distinct == np.round(distinct)).all() else float(steps.min())
    multiples = distinct / unit
    if (whole and unit != 1.0) or np.abs(multiples - np.round(multiples)).max() > STEP_TOLERANCE:
        return None
    for bits in BITS:
        modulus = 2**bits
        span = modulus - (multiples[k] - multiples[k - 1])  # of the signed numbers
        is_at_both_ends = multiples[k - 1] < modulus // 2 <= multiples[k]
        distance = modulus - multiples[-1] + multiples[0]  # of the signed groups
        width = max(multiples[k - 1] - multiples[0], multiples[-1] - multiples[k])
        if multiples[-1] < modulus and distance < width and is_at_both_ends and span < modulus // 2:
            return modulus * unit, (modulus // 2 - 1) * unit
    return None

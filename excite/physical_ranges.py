"""Ranges within which a number in the description of a robot is accepted, wider than machines need.

They tell what may be an unusual robot from what can only be a mistake, a placeholder or an attack:
a mass of 1e300 kg overflows in the first product, and a velocity limit of 1e-300 rad/s underflows
in the first square. With the ranges below, the products of up to four factors that the dynamics
form are normal floating-point numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """An accepted range of a number.

    Attributes:
        lower: Least number, in `unit`.
        upper: Largest number, in `unit`.
        unit: SI unit, for messages; "1" for none.
        smallest: Least magnitude other than 0; 0 where rounding residues such as 1e-66 are usual.
        zero: Whether 0 is accepted, where the range includes it.
    """

    lower: float
    upper: float
    unit: str
    smallest: float = 0.0
    zero: bool = True

    def accepts(self, value: float) -> bool:
        """Return True for a finite number within the range."""
        if not (math.isfinite(value) and self.lower <= value <= self.upper):
            return False
        return self.zero if value == 0.0 else abs(value) >= self.smallest

    def __str__(self) -> str:
        """The range in words, as in "from -1e+04 to 1e+04 m"."""
        text = f"from {self.lower:g} to {self.upper:g}" + (
            "" if self.unit == "1" else f" {self.unit}"
        )
        if self.lower <= 0.0 <= self.upper and not self.zero:
            text += ", not 0"
        return (
            text
            if self.smallest <= max(self.lower, 0.0)
            else f"{text}, no nearer to 0 than {self.smallest:g}"
        )


STATED_POSITION = Range(-1e20, 1e20, "rad")
"""Position limits of a revolute joint before they are doubted: ±1e16 is how some URDFs say that
there is none."""
MASS = Range(0.0, 1e6, "kg", smallest=1e-12)
LENGTH = Range(-1e4, 1e4, "m")
SIZE = Range(1e-9, 1e4, "m")
ANGLE = Range(-1e3, 1e3, "rad")
INERTIA = Range(-1e10, 1e10, "kg m²")
AXIS = Range(-1e6, 1e6, "1")
POSITION = Range(-1e6, 1e6, "rad or m")
VELOCITY = Range(-1e6, 1e6, "rad/s or m/s", smallest=1e-9)
EFFORT = Range(-1e9, 1e9, "N m or N", smallest=1e-9)
VISCOUS_FRICTION = Range(-1e9, 1e9, "N m s/rad or N s/m")
COULOMB_FRICTION = Range(-1e9, 1e9, "N m or N")
ROTOR_INERTIA = Range(-1e9, 1e9, "kg m² or kg")
MIMIC_MULTIPLIER = Range(-1e6, 1e6, "1", smallest=1e-6)
MESH_SCALE = Range(-1e6, 1e6, "1", smallest=1e-9, zero=False)
GRAVITY = Range(-1e3, 1e3, "m/s²")
PERIOD = Range(1e-3, 1e6, "s")
RATE = Range(1e-3, 1e5, "Hz")
HARMONICS = Range(1, 100, "1")
"""Harmonics of a Fourier series. Designs use 3 to 10; matrices grow with the square."""
LEAD = Range(0.1, 600.0, "s")
"""Time that a controller gets for the way from the present pose to the start pose."""
TOLERANCE = Range(1e-6, 10.0, "rad or m")
"""Deviation of a joint that a controller accepts."""
PERIODS = Range(1, 1e5, "1")
SAMPLES = Range(1, 20_000, "1")
"""Samples of the optimiser's grid, on which verification computes the criterion again: 40 to 400
are usual; with 6 joints, 20,000 take 80 MB."""
SEED = Range(0, 2**53, "1")
"""Seeds stand in JSON files, of which many readers take integers up to 2⁵³ exactly."""

"""Options of goals for ROS 2 trajectory controllers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from .. import physical_ranges as ranges
from ..errors import UnusableInput

DEFAULT_LEAD = 5.0
"""Time from the present pose to the start pose [s]: a robot that is 0.1 rad off moves there at
0.02 rad/s."""
OPTIONS_BY_FORMAT = {
    "ros2-joint-trajectory": ("lead",),
    "ros2-follow-joint-trajectory": ("lead", "path_tolerance", "goal_tolerance"),
}
"""Options that a format holds; formats that are not named hold none."""


@dataclass(frozen=True)
class GoalOptions:
    """Options of a goal.

    Attributes:
        lead: Time from the present pose to the start pose [s].
        path_tolerance: Deviation from the path at which the controller aborts, at every joint [rad
            or m]; None: the controller's own.
        goal_tolerance: Deviation at the end that is accepted, at every joint [rad or m]; None: the
            controller's own.
    """

    lead: float = DEFAULT_LEAD
    path_tolerance: float | None = None
    goal_tolerance: float | None = None

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnusableInput: A number is outside its range.
        """
        for name, value in dataclasses.asdict(self).items():
            accepted = ranges.LEAD if name == "lead" else ranges.TOLERANCE
            if value is not None and not accepted.accepts(value):
                raise UnusableInput(f"{_option(name)} {value:g} should be a number {accepted}")

    def require_format(self, format: str) -> None:
        """Check that a format holds the stated options.

        Raises:
            UnusableInput: It does not.
        """
        for field in dataclasses.fields(self):
            is_stated = getattr(self, field.name) != field.default
            if is_stated and field.name not in OPTIONS_BY_FORMAT.get(format, ()):
                holding = [name for name, held in OPTIONS_BY_FORMAT.items() if field.name in held]
                raise UnusableInput(
                    f"{_option(field.name)}: goes with the format {' or '.join(holding)}, not with "
                    f"{format}; leave it out"
                )


def _option(name: str) -> str:
    """Return the command-line option of a field."""
    return f"--{name.replace('_', '-')}"

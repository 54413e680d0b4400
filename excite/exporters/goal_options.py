"""Options of goals for ROS 2 trajectory controllers."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_LEAD = 5.0
"""Time from the present pose to the start pose [s]: a robot that is 0.1 rad off moves there at
0.02 rad/s."""


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

"""Optimal excitation trajectories for robot identification."""

__version__ = "0.1.0"

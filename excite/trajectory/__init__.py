"""excite.trajectory."""

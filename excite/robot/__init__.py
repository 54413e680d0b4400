"""excite.robot."""

"""excite.cli."""

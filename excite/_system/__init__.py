"""excite._system."""

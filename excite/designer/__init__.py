"""excite.designer."""

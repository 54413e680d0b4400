"""excite.report.figures."""

"""Figures of the reports: each function takes results and returns an SVG picture as text."""

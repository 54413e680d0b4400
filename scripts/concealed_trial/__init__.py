"""The concealed trial: analysts name hidden physics from recordings; then the answers are scored.

The package shares no code with identification or diagnosis. It knows an analyst only as a command
that turns a URDF and CSV files into a `diagnosis.json`.
"""

"""The concealed trial: robots with hidden physics, answers from recordings alone, then the key.

It shares no code with what identifies or diagnoses, any more than the plant does: it knows an analyst as a command that
turns a CSV and a URDF into a `diagnosis.json`.
"""

"""Design of excitation trajectories: problem, search, ramps, certificate and identifiability.

`pipeline.design_trajectory` runs all steps; `time_budget` chooses the motion for a robot time, and
`validation_trajectory` designs a second motion.
"""

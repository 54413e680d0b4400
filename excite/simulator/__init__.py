"""Simulated robots with hidden physics, for `excite simulate` and for testing diagnoses.

The package shares no code with design, identification or diagnosis, so that an error in one cannot
cancel in the other: rigid-body dynamics are MuJoCo's, and friction, transmission, controller and
measurement are modelled here. Of excite it imports only the errors and the array types.
"""

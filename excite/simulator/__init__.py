"""A simulated robot that hides physics from those who identify it.

Nothing here is shared with what designs, identifies or diagnoses: rigid bodies are MuJoCo's, the joints' physics, the
controller and the measurement chain are this package's own. It imports nothing of excite but its errors.
"""

"""Collision avoidance: geometry of a robot and its surroundings, clearance constraints for the
optimiser, and the independent continuous check of the certificate."""

"""Collision geometry: shapes of its links and surroundings, distances for the optimiser, and
the certificate's own check."""

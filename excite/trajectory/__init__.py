"""Motions: Fourier series, motions from rest to rest, and the trajectory file."""

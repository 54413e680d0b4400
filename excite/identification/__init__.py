"""Identification of physically consistent robot parameters from recordings."""

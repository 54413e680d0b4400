"""Diagnosis: find the effects that a robot model lacks, from recordings of the robot."""

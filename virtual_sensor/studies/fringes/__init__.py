"""Fringe projection: the study, its results and their files."""

"""Straight and bent light paths."""

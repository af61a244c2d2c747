"""Fringes: sequences of patterns, and the projector's pixels that camera images of them show."""

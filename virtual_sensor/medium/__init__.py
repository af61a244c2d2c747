"""The air and its refractive index."""

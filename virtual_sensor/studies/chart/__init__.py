"""The chart of speed against accuracy: what each configuration costs, and where methods fail."""

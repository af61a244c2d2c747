"""The chart of speed against accuracy: what each rung costs, and where each method fails."""

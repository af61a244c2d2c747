"""A fair trial of line detectors: images of known truth, the same for all, beside the bound."""

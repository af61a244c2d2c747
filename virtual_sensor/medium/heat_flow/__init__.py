"""Heat flow: from a hot part to the air's field, with OpenFOAM."""

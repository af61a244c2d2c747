"""The scenes that come with the program, and the index fields that they use."""

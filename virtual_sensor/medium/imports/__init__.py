"""Fields of air from other solvers: read, chosen from, placed in the world and put on a grid."""

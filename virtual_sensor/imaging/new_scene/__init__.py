"""A scene of one's own: a part, and a sensor over it that suits it."""

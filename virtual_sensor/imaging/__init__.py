"""From a scene file to rendered frames."""

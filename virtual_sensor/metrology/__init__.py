"""From image to line centres to points; knows no Mitsuba, takes arrays."""

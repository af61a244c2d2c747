"""Which strategies there are, and how many of a campaign's cases each has."""

from hostile import arguments, calibrations, commands, fields, images, imports, scenes

BY_KIND = {
    "image": images.cases,
    "field": fields.cases,
    "table": imports.table_cases,
    "mesh": imports.mesh_cases,
    "calibration": calibrations.cases,
    "scene": scenes.cases,
    "call": arguments.cases,
    "command": commands.cases,
}
SHARES = {
    "image": 8.0,
    "field": 4.0,
    "table": 3.0,
    "mesh": 0.7,
    "calibration": 4.0,
    "scene": 2.0,
    "call": 2.0,
    "command": 0.5,
}

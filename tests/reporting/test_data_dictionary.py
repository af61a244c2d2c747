"""The data dictionary lists what the program writes, as the program's own words say it."""

from data_dictionary import maker

from virtual_sensor.records import documented


def test_every_command_that_writes_files_lists_them_with_every_column_and_key():
    """Rationale: what nobody documents, users guess at."""
    files = maker().files()
    commands = {"measure", "search", "burst", "sweep", "detect", "trial", "chart", "reproduce"}
    assert commands | {"field info", "field convergence"} <= files.keys()
    for command, written in files.items():
        for each in written:
            assert each.words.endswith("."), (command, each.pattern)
            fields = each.fields
            assert all(field.words for field in fields), (command, each.pattern)
            for field in fields:
                for kind in field.records:
                    assert documented(kind)

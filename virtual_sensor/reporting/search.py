"""Searched rays as people read them."""

from virtual_sensor.reporting.files import FileOf
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.studies.search import Search, SearchTable

FILES = (FileOf("*.csv", "The rays that were searched (`-o`).", SearchTable),)


def on_console(result: Search) -> TextTable:
    """The rays, one a row."""
    columns = (
        Column("y_mm", "y, mm", "{:.4f}"),
        Column("pixel_u", "u, px", "{:.4f}", "none"),
        Column("pixel_v", "v, px", "{:.4f}", "none"),
        Column("distance_um", "distance, µm", "{:.2g}", "none"),
        Column("marches", "marches", "{}"),
        Column("status", "status"),
    )
    return text_table(result.rays, columns)

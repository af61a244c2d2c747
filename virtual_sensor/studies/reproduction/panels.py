"""What is drawn where in the paper's figures 6 to 11, and how it looks in every picture."""

from __future__ import annotations

from dataclasses import dataclass

from virtual_sensor.studies.reproduction.figures import SEEN_RAY_MM

Look = tuple[str, str, str]
"""Label, colour and marker."""

LOOKS: dict[str, Look] = {
    "dx_um": ("Δx along the cylinder", "#0072b2", "o"),
    "dy_um": ("Δy along the line", "#d55e00", "s"),
    "dz_um": ("Δz upwards", "#009e73", "^"),
    "d_um": ("norm", "black", "D"),
    "du_px": ("Δu along the line", "#d55e00", "s"),
    "dv_px": ("Δv across the line", "#009e73", "^"),
    "d_px": ("norm", "black", "D"),
    "h_d_min_um": ("distance", "black", "D"),
}
"""Of a table's columns; u runs along y, so the two look the same."""

TEMPERATURES: dict[float, Look] = {
    900.0: ("900 °C", "#e69f00", "o"),
    1100.0: ("1100 °C", "#d1495b", "s"),
    1250.0: ("1250 °C", "#5f0f40", "^"),
}
POSES: dict[float, Look] = {
    0.0: ("β = 0°", "#1b3a5c", "o"),
    15.0: ("β = 15°", "#2a9d8f", "s"),
    30.0: ("β = 30°", "#8ab17d", "^"),
}
GROUPS = {"temperature_c": TEMPERATURES, "beta_deg": POSES}
"""By the column that tells curves apart."""

POINTS: dict[str, Look] = {
    "A": ("A (cold)", "#1f5fa8", "#1f5fa8"),
    "straight": ("B (hot) if light ran straight to the camera", "#c8321e", "white"),
    "B": ("B as the camera sees it", "#c8321e", "#c8321e"),
}
"""Of the spots on the sensor; the last is the filling."""

ARROWS = {"9d": ("A", "straight"), "9e": ("straight", "B"), "9f": ("A", "B")}


@dataclass(frozen=True)
class Panel:
    """One diagram.

    Attributes
    ----------
    name : str
        Of its table in `figures.FIGURES`.
    place : tuple of int
        Row, first column and end in the picture's grid.
    title : str
    columns : tuple of str
        Of the table; none for an arrow on the sensor.
    by : str
        Of `GROUPS`, where one column is drawn of several settings.
    stated : tuple of float
        Numbers of the paper.
    told : str
        What the paper says of them.
    log : bool
        Whether the axis is logarithmic: where small curves stand beside a large one.
    """

    name: str
    place: tuple[int, int, int]
    title: str
    columns: tuple[str, ...] = ()
    by: str = ""
    stated: tuple[float, ...] = ()
    told: str = ""
    log: bool = False


@dataclass(frozen=True)
class Picture:
    """One of the paper's figures.

    Attributes
    ----------
    name : str
    setting : str
        Temperature and pose in words.
    words : str
        What it shows, for those who have not read the paper.
    grid : tuple of int
        Rows and columns of each half.
    row_in : float
        Height of a row with its titles, inches.
    panels : tuple of Panel
    """

    name: str
    setting: str
    words: str
    grid: tuple[int, int]
    row_in: float
    panels: tuple[Panel, ...]


_XYZ = ("dx_um", "dy_um", "dz_um", "d_um")
_UV = ("du_px", "dv_px", "d_px")
_UM, _PX = ("d_um",), ("d_px",)
_FROM_ABOVE = "1250 °C, β = 0°"
_HOTTER, _TURNED = "temperature_c", "beta_deg"
_RAY = f"y = {SEEN_RAY_MM:g} mm".replace("-", "−")
_BOUNDS = "below 20 µm at 15°, below 7 µm at 30°"

PICTURES = (
    Picture(
        "6",
        _FROM_ABOVE,
        "How far beside its goal, on the object, the paper's search for a light path ends."
        " Only the search has such a distance, no frame.",
        (1, 2),
        3.6,
        (
            Panel(
                "6",
                (0, 0, 2),
                "distance h_d_min in the helper frame",
                ("h_d_min_um",),
                stated=(1.0,),
                told="below 1 µm",
            ),
        ),
    ),
    Picture(
        "7",
        _FROM_ABOVE,
        "Hot air moves the laser's spot from A (cold) to B (hot), and the point that the sensor"
        " measures from Aₘ to Bₘ.",
        (3, 4),
        2.2,
        (
            Panel("7a", (0, 0, 2), "(a) B − A: the spot on the object", _XYZ),
            Panel(
                "7b",
                (0, 2, 4),
                "(b) B − Bₘ: real minus measured, hot",
                _XYZ,
                stated=(75.0,),
                told="norm up to 75 µm",
            ),
            Panel("7c", (1, 0, 2), "(c) Bₘ − Aₘ: measured, hot minus cold", _XYZ),
            Panel("7d", (1, 2, 4), "(d) B − A: the spot on the sensor", _UV),
            Panel(
                "7e",
                (2, 1, 3),
                "(e) A − Aₘ: real minus measured, cold, in steps of 0.25 px",
                _XYZ,
                stated=(2.7,),
                told="norm up to 2.7 µm",
            ),
        ),
    ),
    Picture(
        "9",
        _FROM_ABOVE,
        "Figure 7(d) split by path: what bends the laser on its way to the object moves the spot"
        " one way, what bends the light on its way to the camera moves it back.",
        (2, 6),
        3.0,
        (
            Panel(
                "9a",
                (0, 0, 2),
                "(a) laser → object",
                _UV,
                stated=(-4.0,),
                told="Δu falls to about −4",
            ),
            Panel("9b", (0, 2, 4), "(b) object → camera", _UV, stated=(2.0,), told="Δu exceeds 2"),
            Panel("9c", (0, 4, 6), "(c) laser → camera", _UV, stated=(-0.5,), told="Δu round −0.5"),
            Panel("9d", (1, 0, 2), f"(d) {_RAY}"),
            Panel("9e", (1, 2, 4), f"(e) {_RAY}"),
            Panel("9f", (1, 4, 6), f"(f) {_RAY}"),
        ),
    ),
    Picture(
        "10b",
        _FROM_ABOVE,
        "The spot on the sensor as a camera tells it that finds it in steps of 0.25 px, and what"
        " this makes of the measured points.",
        (1, 4),
        3.6,
        (
            Panel("10b", (0, 0, 2), "(b) B − A in steps of 0.25 px", _UV),
            Panel("10b", (0, 2, 4), "(b) Bₘ − Aₘ from these pixels", _XYZ),
        ),
    ),
    Picture(
        "11",
        "three temperatures, three poses",
        "How far the measured points and the pixels move: (a) to (c) for a hotter cylinder, seen"
        " from above; (d) and the last for a sensor turned aside.",
        (3, 4),
        2.2,
        (
            Panel("11a", (0, 0, 2), "(a.1) |Bₘ − Aₘ|", _UM, _HOTTER),
            Panel("11b", (0, 2, 4), "(a.2) |Bₘ − Aₘ| in steps of 0.25 px", _UM, _HOTTER),
            Panel("11c", (1, 0, 2), "(c) |B − A| on the sensor", _PX, _HOTTER),
            Panel("11d", (1, 2, 4), "(d) |B − A| on the sensor, 900 °C", _PX, _TURNED),
            Panel(
                "11d",
                (2, 1, 3),
                "|Bₘ − Aₘ|, 900 °C: not drawn in the paper",
                _UM,
                _TURNED,
                (20.0, 7.0),
                _BOUNDS,
                log=True,
            ),
        ),
    ),
)

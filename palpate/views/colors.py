"""Colours of the Rerun views: readable on Rerun's dark and on its light background."""

Color = tuple[int, int, int]

MEASURED: Color = (74, 158, 232)
COMMANDED: Color = (238, 176, 88)
DESIRED: Color = (226, 104, 92)
TRUTH: Color = (226, 104, 92)
FINAL: Color = (98, 190, 150)
BAND: Color = (72, 128, 106)
SECTIONS: tuple[Color, ...] = (
    (74, 158, 232),
    (238, 176, 88),
    (98, 190, 150),
    (178, 134, 222),
    (226, 104, 92),
    (120, 196, 210),
)
FORCE_ARROW: Color = (240, 92, 84)
OBJECT_TOP: Color = (226, 168, 124)
OBJECT_SIDE: Color = (168, 116, 84)
BACKGROUND: Color = (24, 29, 36)
GRID: tuple[int, int, int, int] = (120, 134, 150, 60)


def from_hex(text: str) -> Color:
    """Red, green and blue (0 to 255) of "#rrggbb"."""
    red, green, blue = (int(text[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue

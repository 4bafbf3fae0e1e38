"""The colours of box and jack wherever they are drawn: in frames, on the animated page, in plots.

Each stands out on a white ground and on a dark one.
"""

from __future__ import annotations

Colour = tuple[int, int, int]  # red, green, blue, each from 0 to 255

WALL: Colour = (204, 36, 41)  # and three feet
JACK: Colour = (46, 111, 208)
FIRST_FOOT: Colour = (255, 176, 0)  # its own, so that the cross visibly turns
TORQUE: Colour = (0, 128, 128)


def hexed(colour: Colour) -> str:
    """A colour for CSS and matplotlib."""
    return "#" + bytes(colour).hex()

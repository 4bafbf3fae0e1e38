"""Where the vector environment finds the pictures in a grid; they are drawn in `renderer.py`."""

from jackbox_env.render.renderer import tiled as tiled

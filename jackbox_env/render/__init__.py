"""Pictures: the renderer, and the window to play in."""

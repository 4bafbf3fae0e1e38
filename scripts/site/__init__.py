"""The page in which the jack in a box is played, with the exact model compiled for WebAssembly."""

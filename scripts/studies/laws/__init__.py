"""Random scenes held against the laws of mechanics, for hours."""

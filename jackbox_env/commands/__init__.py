"""The commands of an installed wheel: simulate, play, fit, check."""

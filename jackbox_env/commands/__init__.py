"""The commands of an installed wheel: simulate, play, replay, fit, check."""

"""Fits of scenes to recordings: people's files, first guesses, windows, least squares, outcome."""

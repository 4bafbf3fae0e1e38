"""Checked arguments, atomic files, colours, command lines, one thread at a time."""

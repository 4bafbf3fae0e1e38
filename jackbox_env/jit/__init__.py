"""Compiling: what numba makes of plain functions, and the machine code on disk."""

"""Environments: single, and many at once."""

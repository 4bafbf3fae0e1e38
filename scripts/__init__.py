"""Thin command lines over jackbox_env and agents."""

"""Worked examples with Stable-Baselines3, each a file to copy."""

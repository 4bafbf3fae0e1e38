"""Environments: single, many at once, and for Stable-Baselines3; how their functions are called, and saved models."""

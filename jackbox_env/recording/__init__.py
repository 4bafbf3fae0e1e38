"""Trajectories, the page that animates them, and files."""

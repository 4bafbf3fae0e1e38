"""Policies: scripted, planning, one bounce, trained networks."""

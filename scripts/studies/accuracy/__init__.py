"""Speed against accuracy: every contact model and setting on the same cases. ``scripts/benchmark.py`` runs it."""

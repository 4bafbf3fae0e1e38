"""Speed against accuracy: every contact model and setting on the same cases. ``scripts/studies/accuracy/benchmark.py`` runs it."""

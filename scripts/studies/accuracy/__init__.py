"""Speed against accuracy: every contact model and setting on the same cases; ``benchmark.py`` is the command."""

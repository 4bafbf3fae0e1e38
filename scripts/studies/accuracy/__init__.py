"""Speed against accuracy: every contact model and setting on the same cases; ``accuracy.py`` is the command."""

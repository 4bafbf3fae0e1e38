"""How often fits are right, what they cost, and what the command prints: docs/fitting.md."""

"""How fast the environment and the exact model are, beside others on the same core: docs/speed.md."""

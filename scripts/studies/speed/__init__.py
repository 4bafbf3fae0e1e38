"""How fast the environment and the exact model are, compared with others on the same core: docs/speed.md."""

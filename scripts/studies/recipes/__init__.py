"""The study of docs/recipes.md: what the recipes earn, and their processor time."""

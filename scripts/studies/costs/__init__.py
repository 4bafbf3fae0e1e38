"""The cost of each modelled thing per step: docs/costs.md."""

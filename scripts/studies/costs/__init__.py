"""What each modelled thing costs per step, and the proof that what is off is not executed: docs/costs.md."""

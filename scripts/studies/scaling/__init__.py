"""What sweeps gain from more workers and machines: docs/scaling.md."""

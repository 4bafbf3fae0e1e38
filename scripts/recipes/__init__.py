"""Short programs that use the environment with other libraries; ``make recipes`` runs them all."""

"""Planning on the exact model: rollouts, a search among them, derivatives, and wrappers that use them."""

"""Planning on the exact model: rollouts, derivatives, and wrappers that use them."""

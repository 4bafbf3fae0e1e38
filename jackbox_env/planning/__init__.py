"""Planning on the exact model: rollouts, a search among them, derivatives, and wrappers that use them."""

from jackbox_env.planning.rollouts import Rollout, rollout

__all__ = ["Rollout", "rollout"]

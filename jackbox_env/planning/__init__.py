"""Planning by the exact model: rollouts, a search among them, looking ahead as an observation."""

from jackbox_env.planning.rollouts import Rollout, rollout

__all__ = ["Rollout", "rollout"]

"""What an agent observes."""

from jackbox_env.model.observation import Observation

__all__ = ["Observation"]

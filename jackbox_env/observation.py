"""What an agent observes."""

from jackbox_env.model.observation import Observation, observation_of

__all__ = ["Observation", "observation_of"]  # the last one: pickles name it

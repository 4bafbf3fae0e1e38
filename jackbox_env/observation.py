"""What an agent observes."""

from jackbox_env.model.observation import Observation, observation_of
from jackbox_env.model.pixels import Pixels

__all__ = ["Observation", "Pixels", "observation_of"]  # the last one: pickles name it

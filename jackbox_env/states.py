"""States by name."""

from jackbox_env.model.states import STATE_NAMES, State

__all__ = ["STATE_NAMES", "State"]

"""PPO training in a run folder."""

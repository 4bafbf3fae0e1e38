"""Agents for JackInBox-v0: scripted policies, PPO training, evaluation, film. Used from a checkout, not shipped."""

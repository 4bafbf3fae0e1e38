"""Settings of a small training run."""

from __future__ import annotations

from agents.settings import TrainSettings

# Seconds instead of minutes: an update every 64 steps of 4 environments.
TINY = TrainSettings(
    total_steps=2048,
    num_envs=4,
    rollout_steps=64,
    batch_size=64,
    epochs=2,
    checkpoint_steps=512,
    eval_steps=1024,
    eval_episodes=4,
    hidden_units=(16,),
    observation="state",
    action="torque",
    action_repeat=1,
)

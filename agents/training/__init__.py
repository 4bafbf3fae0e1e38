"""PPO training in a run folder, and the scripts that make the networks of agents/trained."""

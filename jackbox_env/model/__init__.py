"""The model in pure functions: scene, state, mechanics, tasks, observations, actions, landings."""

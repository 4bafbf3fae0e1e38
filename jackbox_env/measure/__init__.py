"""How accurate the models are, and which setting to use."""

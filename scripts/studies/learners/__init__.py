"""The study of docs/learners.md: what the fidelity of training does to a trained agent."""

"""What a contact setting does to a learner: docs/learning.md."""

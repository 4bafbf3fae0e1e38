"""Returns of policies: docs/results.md, and the networks in agents/trained."""

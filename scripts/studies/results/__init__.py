"""What policies earn: docs/results.md, and the networks in agents/trained."""

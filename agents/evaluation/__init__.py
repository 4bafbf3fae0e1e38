"""Returns of policies, their films and pages."""

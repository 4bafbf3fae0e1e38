"""Pictures of the box and the jack."""

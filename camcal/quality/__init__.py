"""Quality of results, in numbers."""

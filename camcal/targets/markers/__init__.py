"""Detection and measurement of square markers, and tags on objects."""

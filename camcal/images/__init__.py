"""Images in, images out, and the geometry between."""

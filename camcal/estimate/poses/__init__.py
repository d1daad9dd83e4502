"""The pose of an object from its points and their pixels: starts, minima, RANSAC, quality."""

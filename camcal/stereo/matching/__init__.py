"""From two images to the disparity of every pixel."""

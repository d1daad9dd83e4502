"""From images of boards to cameras, and what is done with a camera."""

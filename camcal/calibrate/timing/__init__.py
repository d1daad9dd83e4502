"""When cameras took their images: time offsets, clock rates and rolling shutters, by the motion of a board."""

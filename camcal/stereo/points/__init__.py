"""From disparity to points in space."""

"""Corner refinement."""

"""Planning with a lens, a sensor and a board."""

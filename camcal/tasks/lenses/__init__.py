"""What a lens, a sensor and a board will be worth."""

"""Raw frames: development, corrections, and sensor characterisation."""

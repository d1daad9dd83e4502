"""Raw frames: reading, correction, demosaicing, and sensor characterisation."""

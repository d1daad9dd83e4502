"""From the sensor's counts to light: raw frames read, corrected, developed, and what the sensor itself can do."""

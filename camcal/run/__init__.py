"""Settings, inputs and the fan-out."""

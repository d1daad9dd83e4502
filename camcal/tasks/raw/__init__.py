"""Raw frames: development, corrections, and the sensor behind them."""

"""camcal: calibrate, rectify and measure with cameras from the shell."""

__version__ = "0.1.0"

"""Raw frames: reading, correction, demosaicing, and sensor characterisation.

Here are the names of colour filter patterns, byte layouts and demosaicing algorithms, as options and files give them.
"""

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
MONO = "MONO"
ENDIANS = ("little", "big")
ALIGNS = ("lsb", "msb")

AUTO, RI, HALF, NONE = "auto", "ri", "half", "none"
GREEN, GRAY = "green", "gray"
COLOURS = ("red", "blue")  # whose lenses differ from that of green
LIBRAW = "libraw:"  # before the name of one of LibRaw's filters

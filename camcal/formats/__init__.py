"""File formats of camcal and of other programs; conversions are exact or refused."""

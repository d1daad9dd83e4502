"""Hand–eye calibration: a camera and a board, one of which a robot moves."""

"""The report of a result as one self-contained HTML page."""

"""Figures of results: what each shows, its caption, and the files that they are written to."""

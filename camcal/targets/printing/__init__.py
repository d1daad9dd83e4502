"""Boards drawn on paper at true scale."""

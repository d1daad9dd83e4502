"""Boards, their shape, and finding them in images."""

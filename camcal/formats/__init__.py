"""Everybody's file formats, exact or refused."""

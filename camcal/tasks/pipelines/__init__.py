"""Pipelines: several commands, described in one file."""

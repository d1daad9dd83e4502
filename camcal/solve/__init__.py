"""The one least-squares solver of the package."""

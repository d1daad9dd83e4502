"""One function per command: options in, record out."""

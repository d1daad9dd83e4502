"""Square markers found, read and measured in images, and what they are on."""

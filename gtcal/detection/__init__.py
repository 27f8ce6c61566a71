"""Boards found in images: tags, then corners to a fraction of a pixel."""

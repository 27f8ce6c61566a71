"""Recordings: the manifest, and what it names, as arrays."""

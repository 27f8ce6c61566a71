"""What may be wrong with a recording, and the line of the manifest to change."""

"""Cameras and rigs in the files of other tools: one module per format, its reader beside its writer."""

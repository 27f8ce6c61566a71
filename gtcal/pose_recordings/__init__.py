"""Recordings of poses in place of corners: what a detector, a tracker or a robot's log made of each view."""

"""Recordings of several boards at once, known apart by their tags: one X each, all cameras in one estimate."""

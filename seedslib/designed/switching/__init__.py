"""Shelf: the filter of a switching system, what its memory says, its steps and their lemmas."""

"""Shelf: designs on simulated paths."""

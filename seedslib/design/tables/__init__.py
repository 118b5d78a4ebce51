"""Shelf: designs as tables, by regression on paths."""

"""Shelf: a designed filter as one C header."""

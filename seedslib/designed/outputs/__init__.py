"""Shelf: filters of output functions, which tables are one kind of."""

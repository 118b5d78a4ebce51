"""Shelf: closed forms of E f(x), from symbols to numbers."""

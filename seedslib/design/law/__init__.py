"""Shelf: designs on the law of memory and state over a grid."""

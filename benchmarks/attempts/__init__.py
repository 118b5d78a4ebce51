"""Illegal and extreme input, a file a category; each has ``attempts()``, always the same ones."""

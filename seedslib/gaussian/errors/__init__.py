"""Shelf: exact mean-square errors of estimates of functions."""

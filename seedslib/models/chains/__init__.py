"""Chains on a grid in the place of a system: what the exact recursions move laws along with."""

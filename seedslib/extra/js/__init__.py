"""Shelf: the same filters as one ECMAScript module, translated from their C."""

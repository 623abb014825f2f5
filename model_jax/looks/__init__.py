"""Looks: one file each, a class with parameters and `air`; `_registry` finds them."""

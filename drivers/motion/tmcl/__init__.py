"""Trinamic motion modules on their serial line."""

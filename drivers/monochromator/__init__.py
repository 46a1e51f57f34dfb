"""The Oriel Cornerstone 260 on its serial line, and its order-sorting filters."""

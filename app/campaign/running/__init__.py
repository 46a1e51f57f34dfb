"""Rows carried out: the engine, what it decides while it measures, and what it does about faults."""

"""Execution of a plan: the engine, its rows, the stop conditions, and the recovery from faults."""

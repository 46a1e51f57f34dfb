"""What the operator wants measured: the schedule file, its grids, and how its rows are measured."""

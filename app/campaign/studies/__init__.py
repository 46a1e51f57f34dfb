"""Studies: what a campaign shows of its own rig and of its values: closure, alignment, watch, checks, budgets, comparison."""

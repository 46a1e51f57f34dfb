"""The planner: from a schedule and a rig file to rows in order, and what is known about them before anything moves."""

"""From a schedule and a rig to rows in order, and what can be said of them before anything moves."""

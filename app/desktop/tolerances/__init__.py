"""The tolerances screen: studies of the instrument's deviations, computed beside the window."""

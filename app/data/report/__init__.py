"""The report of a campaign: one HTML file with all that belongs to its values."""

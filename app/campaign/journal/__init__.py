"""One SQLite file a campaign: crash journal, resume pointer and archive."""

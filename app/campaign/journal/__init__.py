"""The data file of a campaign (journal): one SQLite file with every row, from which a stopped campaign resumes."""

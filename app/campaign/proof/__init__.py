"""The proof: many virtual rigs, each off by what its file states, against the truth of their samples."""

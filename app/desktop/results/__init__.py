"""The results screen: the values of a campaign or of a file."""
